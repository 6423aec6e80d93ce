// The library's pools at one thread: handing a picture of some texels to another takes longer than the work, and what is found
// is found again.
#include <OpenEXR/ImfThreading.h>
#include <OpenImageIO/imageio.h>
#include <tbb/global_control.h>

#include "io/internal.h"

namespace {

struct OneThread {
    tbb::global_control limit{tbb::global_control::max_allowed_parallelism, 1};
    OneThread() {
        OIIO::attribute("threads", 1);
        // The pool of OpenEXR grows at the first file; after that it can be taken away.
        spectex::io::prepare_threads(1);
        Imf::setGlobalThreadCount(0);
    }
};
const OneThread one_thread;

}  // namespace
