#include "evaluation/stability.h"
namespace spectex::stability {
Status study_methods(Study&) { return {}; }
Status study_solvers(Study&) { return {}; }
Status study_lights(Study&) { return {}; }
Status study_sums(Study&) { return {}; }
Status study_conditioning(Study&) { return {}; }
}
