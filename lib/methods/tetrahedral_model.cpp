#include "methods/tetrahedral_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace spectex::registry {

TetrahedralModel::TetrahedralModel(const MethodInfo& info, const Colorimetry& colorimetry, LatticeTable table)
    : Model(info, colorimetry), table_(std::move(table)) {}

void TetrahedralModel::reflectance(std::span<const double> rgb, std::span<double> out) const {
    kernels::interpolate_lattice(table_, rgb, out);
}

std::string TetrahedralModel::to_json() const {
    Json json = model_json(*this);
    json["knots"] = table_.knots;
    json["vertices"] = table_.vertices;
    return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Vector3 vertex_color(const LatticeTable& table, std::size_t vertex) {
    const std::size_t blues = table.knots[2].size(), greens = table.knots[1].size();
    return {table.knots[0][vertex / (blues * greens)], table.knots[1][vertex / blues % greens], table.knots[2][vertex % blues]};
}

Result<LatticeTable> read_lattice(const Colorimetry& colorimetry, const Json& json, double low, double high, double slip) {
    const auto wrong = [](std::string why) { return Error{ErrorKind::input, "model: member 'knots': " + std::move(why)}; };
    const auto list = json.find("knots");
    if (list == json.end() || !list->is_array() || list->size() != 3) return wrong("expected three lists");
    LatticeTable table;
    std::size_t vertices = 1;
    for (std::size_t c = 0; c < 3; ++c) {
        constexpr std::size_t most = 256;
        const Json& axis = (*list)[c];
        if (!axis.is_array() || axis.size() < 2 || axis.size() > most)
            return wrong(fmt::format("axis {}: expected 2 to {} numbers", c, most));
        auto knots = read_numbers(Json{{"knots", axis}}, "knots", axis.size(), 0, 1);
        if (!knots) return std::move(knots).error();
        if (knots->front() != 0 || knots->back() != 1 || std::adjacent_find(knots->begin(), knots->end(), std::greater_equal<>()) != knots->end())
            return wrong(fmt::format("axis {}: expected numbers ascending from 0 to 1", c));
        table.knots[c] = *std::move(knots);
        vertices *= table.knots[c].size();
    }
    table.values = colorimetry.bands().size();
    auto numbers = read_numbers(json, "vertices", vertices * table.values, low, high);
    if (!numbers) return std::move(numbers).error();
    table.vertices = *std::move(numbers);
    for (std::size_t v = 0; slip >= 0 && v < vertices; ++v) {
        const Vector3 expected = vertex_color(table, v);
        const Vector3 rgb = colorimetry.rgb_of(std::span<const double>(table.vertices).subspan(v * table.values, table.values));
        for (std::size_t c = 0; c < 3; ++c)
            if (!(std::abs(rgb[c] - expected[c]) <= slip))
                return Error{ErrorKind::input,
                             fmt::format("model: member 'vertices': vertex {} has linear RGB ({}, {}, {}) in this colorimetry, "
                                         "expected ({}, {}, {})",
                                         v, rgb[0], rgb[1], rgb[2], expected[0], expected[1], expected[2])};
    }
    return table;
}

}  // namespace spectex::registry
