#include <fmt/format.h>

#include <cmath>

#include "spectex/color.h"
#include "spectral/names.h"

namespace spectex {
namespace {

struct ConeModel {
    const char* name;
    std::array<const char*, 3> responses;
    Matrix3 from_xyz;
};

// Rows are the cone responses. A row's scale cancels in the adaptation, so the normalisation of a source does not matter.
const ConeModel& cone_model(Adaptation method) {
    // Hunt, Pointer and Estevez, as CIE 159:2004 eq. 12 prints it for equal energy.
    static const ConeModel vonkries{"von Kries", {"long", "medium", "short"},
        {{0.38971, 0.68898, -0.07868, -0.22981, 1.18340, 0.04641, 0.0, 0.0, 1.0}}};
    // Lam 1985; ICC.1:2022 annex E.
    static const ConeModel bradford{"Bradford", {"long (rho)", "medium (gamma)", "short (beta)"},
        {{0.8951, 0.2664, -0.1614, -0.7502, 1.7135, 0.0367, 0.0389, -0.0685, 1.0296}}};
    // CIE 159:2004 eq. 2.
    static const ConeModel cat02{"CAT02", {"long (R)", "medium (G)", "short (B)"},
        {{0.7328, 0.4296, -0.1624, -0.7036, 1.6975, 0.0061, 0.0030, 0.0136, 0.9834}}};
    // Li et al. 2017, doi:10.1002/col.22131, eq. 4 of part 2.
    static const ConeModel cat16{"CAT16", {"long (R)", "medium (G)", "short (B)"},
        {{0.401288, 0.650173, -0.051461, -0.250268, 1.204414, 0.045854, -0.002079, 0.048952, 0.953127}}};
    switch (method) {
        case Adaptation::vonkries: return vonkries;
        case Adaptation::cat02: return cat02;
        case Adaptation::cat16: return cat16;
        default: return bradford;
    }
}

}  // namespace

Result<Adaptation> parse_adaptation(std::string_view name) {
    const auto folded = folded_name(name);
    if (folded == "none") return Adaptation::none;
    if (folded == "vonkries") return Adaptation::vonkries;
    if (folded == "bradford") return Adaptation::bradford;
    if (folded == "cat02") return Adaptation::cat02;
    if (folded == "cat16") return Adaptation::cat16;
    return Error{ErrorKind::usage,
                 fmt::format("chromatic adaptation '{}' is not known: expected none, vonkries, bradford, cat02 or cat16", name)};
}

Result<Matrix3> adaptation_matrix(Adaptation method, const Vector3& from_white, const Vector3& to_white) {
    if (method == Adaptation::none || from_white == to_white) return Matrix3{};
    const auto& model = cone_model(method);
    const Vector3 from = model.from_xyz * from_white, to = model.from_xyz * to_white;
    Matrix3 gains{{0, 0, 0, 0, 0, 0, 0, 0, 0}};
    for (std::size_t i = 0; i < 3; ++i) {
        // Whites are normalised to Y = 1. Below a millionth of that the gain would magnify the rounding of float pixels to
        // the size of the signal; a target response of nothing would erase a cone and leave no inverse.
        constexpr double least_response = 1e-6;
        for (const auto& [side, white, response] : {std::tuple{"source", from_white, from[i]}, {"target", to_white, to[i]}})
            if (!(response > least_response) || !std::isfinite(response))
                return Error{ErrorKind::input,
                             fmt::format("{} adaptation is undefined: the {} white XYZ ({:.6g}, {:.6g}, {:.6g}) has the {} cone "
                                         "response {:.3g}, expected more than {:g}",
                                         model.name, side, white[0], white[1], white[2], model.responses[i], response,
                                         least_response)};
        gains(i, i) = to[i] / from[i];
    }
    return model.from_xyz.inverse() * gains * model.from_xyz;
}

}  // namespace spectex
