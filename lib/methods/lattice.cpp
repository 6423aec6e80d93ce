// Exact metamers at the vertices of a lattice over the linear RGB cube, blended within Kuhn's tetrahedra (Kuhn 1960,
// doi:10.1147/rd.45.0518). The sensing of a spectrum is linear, so that a blend of exact metamers is one of the blended colour:
// the round trip is exact everywhere, and under any light and observer the relit colour is the same blend of relit vertices.
//
// For BT.709 under D65 and CIE 1931 the vertices are shipped at 5 nm. Other bands take the nearest exact metamer of those
// spectra: on bands that include the 5 nm ones nothing changes, so that a colour has one spectrum whatever it is stored in.
// For other observers, lights and spaces the samples' own colours are other ones and the vertices are solved anew.
#include "spectex/solvers.h"

#include <fmt/format.h>
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <mutex>

#include "methods/registry.h"
#include "solvers/lattice.h"

namespace spectex::registry {
namespace {

constexpr std::string_view shipped_lut = "models/lattice9_cie1931_d65_bt709_380-780-5.bin";
/// Changes whenever the same samples would give other spectra.
constexpr std::string_view recipe = "spectex lattice 2";
/// Above this many bands the vertices are solved at 5 nm and transferred: the work grows with the cube of the bands, and
/// measured reflectances hold nothing finer.
constexpr std::size_t most_solved_bands = 120;

class LatticeModel final : public Model {
public:
    LatticeModel(const MethodInfo& info, const Colorimetry& colorimetry, LatticeTable table, std::string hash)
        : Model(info, colorimetry), table_(std::move(table)), hash_(std::move(hash)) {
        const std::size_t n = table_.knots[0].size();
        cells_ = static_cast<double>(n - 1);
        strides_ = {n * n * table_.values, n * table_.values, table_.values};
    }

    void reflectance(std::span<const double> rgb, std::span<double> out) const override {
        const std::size_t bands = table_.values;
        for (std::size_t i = 0; 3 * i + 2 < rgb.size(); ++i) {
            std::array<std::pair<double, std::size_t>, 3> axis;  // position within the cell, step to the next vertex
            const double* v0 = table_.vertices.data();
            for (std::size_t c = 0; c < 3; ++c) {
                const double scaled = std::clamp(rgb[3 * i + c], 0.0, 1.0) * cells_;
                const double cell = std::min(std::floor(scaled), cells_ - 1);
                axis[c] = {scaled - cell, strides_[c]};
                v0 += static_cast<std::size_t>(cell) * strides_[c];
            }
            // Descending and stable; the library's sort would take memory for each pixel.
            const auto order = [&](std::size_t a, std::size_t b) {
                if (axis[b].first > axis[a].first) std::swap(axis[a], axis[b]);
            };
            order(0, 1);
            order(1, 2);
            order(0, 1);
            const double *v1 = v0 + axis[0].second, *v2 = v1 + axis[1].second, *v3 = v2 + axis[2].second;
            const double w0 = 1 - axis[0].first, w1 = axis[0].first - axis[1].first, w2 = axis[1].first - axis[2].first,
                         w3 = axis[2].first;
            double* r = out.data() + i * bands;
            // The weights' sum may round to the number above 1.
            for (std::size_t l = 0; l < bands; ++l)
                r[l] = std::min(((w0 * v0[l] + w1 * v1[l]) + w2 * v2[l]) + w3 * v3[l], 1.0);
        }
    }
    const LatticeTable* lattice() const override { return &table_; }
    std::string to_json() const override {
        Json json = model_json(*this);
        json["table"] = hash_;
        return json.dump(-1, ' ', false, Json::error_handler_t::replace);
    }

private:
    LatticeTable table_;
    std::string hash_;
    double cells_ = 1;
    std::array<std::size_t, 3> strides_{};
};

/// Where the spectra of a colorimetry come from. Its hash is of that data rather than of the solved numbers, whose last bits
/// may differ between compilers.
struct Origin {
    std::string shipped;  ///< bytes of the table, or empty: solved from the samples
    std::string hash;
};

std::string hash_text(XXH64_hash_t hash) { return fmt::format("xxh3-64:{:016x}", hash); }

Result<bool> is_shipped(const Colorimetry& c) {
    if (c.observer().id != "cie1931" || c.rgb_space().name != "BT.709" || c.matrix_kind() != RgbMatrix::integrated) return false;
    const auto d65 = parse_illuminant("D65");
    if (!d65) return d65.error();
    // A file may bear the name.
    const auto& power = c.illuminant().power;
    return power.wavelengths_nm() == d65->power.wavelengths_nm() && power.values() == d65->power.values();
}

Result<Origin> origin(const Colorimetry& colorimetry) {
    const auto shipped = is_shipped(colorimetry);
    if (!shipped) return shipped.error();
    Origin out;
    if (*shipped) {
        auto bytes = lut_text(shipped_lut);
        if (!bytes) return std::move(bytes).error();
        out.shipped = *std::move(bytes);
        out.hash = hash_text(XXH3_64bits(out.shipped.data(), out.shipped.size()));
        return out;
    }
    const auto sets = lattice_sample_sets();
    if (!sets) return sets.error();
    XXH3_state_t* state = XXH3_createState();
    XXH3_64bits_reset(state);
    XXH3_64bits_update(state, recipe.data(), recipe.size());
    const auto add = [&](const std::vector<double>& numbers) {
        XXH3_64bits_update(state, numbers.data(), numbers.size() * sizeof(double));
    };
    for (const auto& set : *sets) {
        add(set.wavelengths_nm);
        for (const auto& sample : set.samples) add(sample);
    }
    out.hash = hash_text(XXH3_64bits_digest(state));
    XXH3_freeState(state);
    return out;
}

Result<LatticeTable> solved(const Colorimetry& colorimetry) {
    const auto sets = lattice_sample_sets();
    if (!sets) return sets.error();
    if (colorimetry.bands().size() <= most_solved_bands) return solve_lattice(colorimetry, *sets);
    if (auto possible = solvers::check_cube(colorimetry); !possible) return possible.error();
    const BandSet working;
    ColorimetrySpec spec{colorimetry.observer().id, "", colorimetry.rgb_space().name, colorimetry.matrix_kind()};
    const auto coarse = Colorimetry::make(spec, working, colorimetry.illuminant());
    if (!coarse) return coarse.error();
    const auto table = solve_lattice(*coarse, *sets);
    if (table) return solvers::transfer_lattice(*table, working, colorimetry);
    // Finer bands have metamers where 5 nm ones have none.
    if (table.error().kind == ErrorKind::infeasible) return solve_lattice(colorimetry, *sets);
    return table.error();
}

/// The shipped table, decoded once a process: every file that names the method asks for it. Another folder of data that
/// replaces it is told by the hash.
Result<LatticeTable> shipped_table(const Origin& from) {
    static std::mutex mutex;
    static std::string decoded_hash;
    static LatticeTable decoded;
    {
        const std::lock_guard lock(mutex);
        if (decoded_hash == from.hash) return decoded;
    }
    const auto own = Colorimetry::make({}, BandSet());
    if (!own) return own.error();
    // Not under the lock: a thread that waits for the others' vertices may take up work that comes here again.
    auto table = solvers::decode_lattice(from.shipped, shipped_lut, *own);
    if (!table) return table;
    const std::lock_guard lock(mutex);
    decoded = *table;
    decoded_hash = from.hash;
    return table;
}

ModelResult make_from(const MethodInfo& info, const Colorimetry& colorimetry, const Origin& from) {
    Result<LatticeTable> table = Error{};
    if (from.shipped.empty()) {
        table = solved(colorimetry);
    } else {
        table = shipped_table(from);
        if (table && colorimetry.bands() != BandSet()) table = solvers::transfer_lattice(*table, BandSet(), colorimetry);
    }
    if (!table) return std::move(table).error();
    return std::shared_ptr<const Model>(std::make_shared<LatticeModel>(info, colorimetry, *std::move(table), from.hash));
}

/// A model of other samples bears no hash that a reader could find again.
ModelResult train_lattice(const MethodInfo& info, const Colorimetry& colorimetry, std::span<const SampleSet> sets) {
    auto table = solve_lattice(colorimetry, sets);
    if (!table) return std::move(table).error();
    return std::shared_ptr<const Model>(std::make_shared<LatticeModel>(info, colorimetry, *std::move(table), "none"));
}

ModelResult make_lattice(const MethodInfo& info, const Colorimetry& colorimetry) {
    const auto from = origin(colorimetry);
    if (!from) return from.error();
    return make_from(info, colorimetry, *from);
}

ModelResult read_vertices(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    const auto hash = read_text(json, "table");
    if (!hash) return hash.error();
    const auto from = origin(colorimetry);
    if (!from) return from.error();
    if (*hash != from->hash)
        return Error{ErrorKind::input, fmt::format("model: member 'table': {} is not the table of this installation, {}: the file "
                                                   "was written with other spectra",
                                                   *hash, from->hash)};
    auto made = make_from(info, colorimetry, *from);
    // From a file an impossible colorimetry is a fault of the file.
    if (!made && made.error().kind == ErrorKind::infeasible) return Error{ErrorKind::input, "model: " + made.error().message};
    return made;
}

}  // namespace

Entry lattice() {
    MethodInfo info;
    info.id = "lattice";
    info.title = "Exact metamers learnt from measurements";
    info.source = "Spectex; tetrahedra of Kuhn 1960, IBM J. Res. Dev. 4(5), doi:10.1147/rd.45.0518";
    info.pieces = Pieces::tetrahedral;
    info.exact = true;
    info.bounded = true;
    info.coefficients = 3;
    return {info, make_lattice, read_vertices, train_lattice};
}

}  // namespace spectex::registry
