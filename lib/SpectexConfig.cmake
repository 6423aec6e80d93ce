# The shared library's own dependencies are private: a consumer needs no other package.
include("${CMAKE_CURRENT_LIST_DIR}/SpectexTargets.cmake")
