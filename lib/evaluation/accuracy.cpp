#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "parallel.h"
#include "spectex/evaluation.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

/// [samples][bands] and their colours.
struct Samples {
    std::string name;
    std::vector<double> spectra, rgb;
    std::size_t count = 0;
};

Result<Samples> inside_cube(const SampleSet& set, const Colorimetry& colorimetry) {
    Samples out{set.name, {}, {}, 0};
    for (const auto& sample : set.samples) {
        const auto measured = SpectralDistribution::make(set.wavelengths_nm, sample);
        if (!measured) return Error{measured.error().kind, set.name + ": " + measured.error().message};
        auto r = measured->resampled(colorimetry.bands().wavelengths_nm(), Interpolation::linear, Extrapolation::hold);
        for (double& v : r) v = std::clamp(v, 0.0, 1.0);
        const Vector3 rgb = colorimetry.rgb_of(r);
        if (!std::all_of(rgb.begin(), rgb.end(), [](double v) { return v >= 0 && v <= 1; })) continue;
        out.spectra.insert(out.spectra.end(), r.begin(), r.end());
        out.rgb.insert(out.rgb.end(), rgb.begin(), rgb.end());
        ++out.count;
    }
    if (out.count == 0)
        return Error{ErrorKind::input, fmt::format("{}: no sample has a colour inside the RGB cube ({})", set.name,
                                                   colorimetry.describe())};
    return out;
}

/// [samples][lamps] Lab, relative to the lamp's white.
std::vector<Vector3> labs(std::span<const double> spectra, std::size_t bands, std::span<const TristimulusWeights> lamps) {
    const std::size_t n = spectra.size() / bands;
    std::vector<Vector3> out(n * lamps.size());
    parallel_for(std::size_t{0}, n, [&](std::size_t s) {
        const double* r = &spectra[s * bands];
        for (std::size_t k = 0; k < lamps.size(); ++k) {
            Vector3 xyz{};
            for (std::size_t c = 0; c < 3; ++c)
                for (std::size_t b = 0; b < bands; ++b) xyz[c] += lamps[k].w[c * bands + b] * r[b];
            out[s * lamps.size() + k] = lab_from_xyz(xyz, lamps[k].white);
        }
    });
    return out;
}

}  // namespace

Result<AccuracyReport> measure_accuracy(const Colorimetry& colorimetry, const AccuracyOptions& options) {
    if (options.methods.empty() || options.sets.empty() || options.lamps.size() + options.probes.size() == 0)
        return Error{ErrorKind::usage, "accuracy: expected at least one method, one set of reflectances and one lamp"};
    std::set<std::string> names;
    for (const auto* list : {&options.sets, &options.unseen})
        for (const auto& set : *list)
            if (!names.insert(set.name).second)
                return Error{ErrorKind::usage, fmt::format("accuracy: the set {} is given twice", set.name)};
    const std::size_t bands = colorimetry.bands().size();
    std::vector<TristimulusWeights> lamps;
    for (const auto& probe : options.probes) {
        auto weights = tristimulus_weights(colorimetry.bands(), colorimetry.observer(), probe, Normalization::luminance);
        if (!weights) return std::move(weights).error();
        lamps.push_back(*std::move(weights));
    }
    for (const auto& lamp : options.lamps)
        // A lamp without visible power shows nothing.
        if (auto weights = tristimulus_weights(colorimetry.bands(), colorimetry.observer(), lamp, Normalization::luminance))
            lamps.push_back(*std::move(weights));
    if (lamps.empty()) return Error{ErrorKind::input, "accuracy: no lamp has power where the observer sees"};

    AccuracyReport report;
    report.lamps = lamps.size();
    struct Case {
        Samples samples;
        std::vector<Vector3> lab;
        std::vector<SampleSet> training;
    };
    std::vector<Case> cases;
    for (const auto* list : {&options.sets, &options.unseen})
        for (const auto& set : *list) {
            auto samples = inside_cube(set, colorimetry);
            if (!samples) return std::move(samples).error();
            Case c{*std::move(samples), {}, {}};
            c.lab = labs(c.samples.spectra, bands, lamps);
            for (const auto& other : options.sets)
                if (other.name != set.name) c.training.push_back(other);
            cases.push_back(std::move(c));
        }
    for (const auto& method : options.methods)
        for (const auto& c : cases) {
            const auto model = train_model(method, colorimetry, c.training);
            if (!model) return model.error();
            std::vector<double> predicted(c.samples.count * bands);
            (*model)->reflectance(c.samples.rgb, predicted);
            const auto lab = labs(predicted, bands, lamps);
            std::vector<double> differences(lab.size());
            parallel_for(std::size_t{0}, c.samples.count, [&](std::size_t s) {
                for (std::size_t k = 0; k < lamps.size(); ++k)
                    differences[s * lamps.size() + k] = delta_e2000(c.lab[s * lamps.size() + k], lab[s * lamps.size() + k]);
            });
            AccuracyRow row{method, c.samples.name, c.samples.count, 0, 0, 0, std::vector<double>(options.probes.size())};
            CompensatedSum sum, rms;
            for (const double d : differences) sum.add(d);
            row.mean = sum.value() / static_cast<double>(differences.size());
            for (std::size_t k = 0; k < options.probes.size(); ++k) {
                CompensatedSum under;
                for (std::size_t s = 0; s < c.samples.count; ++s) under.add(differences[s * lamps.size() + k]);
                row.mean_under[k] = under.value() / static_cast<double>(c.samples.count);
            }
            for (std::size_t s = 0; s < c.samples.count; ++s) {
                double square = 0;
                for (std::size_t b = s * bands; b < (s + 1) * bands; ++b) {
                    const double d = predicted[b] - c.samples.spectra[b];
                    square += d * d;
                }
                rms.add(std::sqrt(square / static_cast<double>(bands)));
            }
            row.rms = rms.value() / static_cast<double>(c.samples.count);
            const auto rank = differences.begin() + static_cast<std::ptrdiff_t>((differences.size() * 95 + 99) / 100 - 1);
            std::nth_element(differences.begin(), rank, differences.end());
            row.p95 = *rank;
            report.rows.push_back(std::move(row));
        }
    return report;
}

}  // namespace spectex
