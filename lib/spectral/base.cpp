#include "spectex/base.h"

namespace spectex {

Matrix3 Matrix3::inverse() const {
    using Real = long double;
    const auto at = [this](std::size_t i, std::size_t j) { return static_cast<Real>((*this)(i, j)); };
    Matrix3 result;
    const auto cofactor = [&](std::size_t i, std::size_t j) {
        const std::size_t i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
        return at(i1, j1) * at(i2, j2) - at(i1, j2) * at(i2, j1);
    };
    const Real determinant = at(0, 0) * cofactor(0, 0) + at(0, 1) * cofactor(0, 1) + at(0, 2) * cofactor(0, 2);
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j) result(i, j) = static_cast<double>(cofactor(j, i) / determinant);
    return result;
}

std::string_view version() { return SPECTEX_VERSION; }

}  // namespace spectex
