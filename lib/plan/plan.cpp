#include "spectex/plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "kernels/convert.h"
#include "kernels/lattice.h"
#include "kernels/linear.h"
#include "kernels/spectra.h"
#include "plan/coefficient_codes.h"
#include "plan/color_memory.h"
#include "plan/quadrature.h"
#include "spectex/io.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

using plan::ColorMemory, plan::ColorMemoryOwner;

/// Pixels that a kernel handles at a time where it needs scratch memory: the scratch stays in the second-level cache.
constexpr std::size_t block_pixels = 1024;
constexpr double largest_half = 65504;

/// When remembering colours pays, as it was measured a moment ago.
PlanLine explain_memory(const plan::BreakEven& b, std::string_view of = "colours") {
    if (b.share() >= 1)
        return {"repeats", fmt::format("{} met before are computed again, which takes {:.0f} ns: remembering costs {:.0f}", of, b.compute, b.missed)};
    return {"skipped", fmt::format("{} met before: each thread keeps what came of the last {} or fewer, wherever {:.2g}% or more come again; fewer do "
                                   "not pay (measured here: {:.0f} ns to compute one, {:.0f} to keep it, {:.0f} to find it)",
                                   of, ColorMemory::most_entries, 100 * b.share(), b.compute, b.missed, b.found)};
}

/// A function that memories can call: light under each illuminant from colours or coefficients, by spectra that are formed.
template <class Reflectance>
class SpectraIntegral {
public:
    /// @param weights  [bands][values]. @param inputs  per colour. @param reflectance  (numbers, spectra).
    SpectraIntegral(const std::vector<double>& weights, std::size_t bands, std::size_t values, std::size_t inputs, const Reflectance& reflectance)
        : weights_(weights), bands_(bands), values_(values), inputs_(inputs), reflectance_(reflectance), sums_(values) {}
    void operator()(std::span<const double> colors, std::span<float> results) const {
        const std::size_t count = colors.size() / inputs_;
        spectra_.resize(std::max(spectra_.size(), bands_ * count));
        reflectance_(colors, std::span<double>(spectra_.data(), bands_ * count));
        for (std::size_t p = 0; p < count; ++p) {
            // All values at once, so that the sums do not wait for each other. In order of the bands; what they lose, 1e-14 of the
            // light, vanishes in the floats.
            std::fill(sums_.begin(), sums_.end(), 0.0);
            for (std::size_t b = 0; b < bands_; ++b) {
                const double r = spectra_[p * bands_ + b];
                const double* w = &weights_[b * values_];
                for (std::size_t j = 0; j < values_; ++j) sums_[j] += w[j] * r;
            }
            for (std::size_t j = 0; j < values_; ++j) results[p * values_ + j] = static_cast<float>(sums_[j]);
        }
    }

private:
    const std::vector<double>& weights_;
    std::size_t bands_, values_, inputs_;
    const Reflectance& reflectance_;
    mutable std::vector<double> spectra_, sums_;
};

/// What a file keeps of colours, as floats: a model's coefficients, or its bands.
class StoredNumbers {
public:
    StoredNumbers(const Model& model, Store store, PixelType type) : model_(model), store_(store), type_(type) {}
    void operator()(std::span<const double> colors, std::span<float> results) const {
        computed_.resize(std::max(computed_.size(), results.size()));
        const std::span<double> computed(computed_.data(), results.size());
        if (store_ == Store::spectral) {
            model_.reflectance(colors, computed);
        } else {
            model_.coefficients(colors, computed);
            if (type_ == PixelType::half) model_.limit_coefficients(computed, largest_half);
        }
        for (std::size_t i = 0; i < results.size(); ++i) results[i] = static_cast<float>(computed[i]);
    }

private:
    const Model& model_;
    Store store_;
    PixelType type_;
    mutable std::vector<double> computed_;
};

/// [3 images][bands]: linear RGB of the output space from a reflectance in the bands, under each illuminant.
struct OutputWeights {
    std::vector<double> w;
    std::vector<Vector3> whites;  // of each illuminant, XYZ
    Matrix3 to_xyz;               // of the output space
};

/// Output RGB from XYZ: the output space's primaries and its own illuminant's white, integrated on the same bands.
Result<Colorimetry> output_colorimetry(const BandSet& bands, const RelightRequest& request) {
    return Colorimetry::make({request.observer, "", request.output_space, RgbMatrix::integrated}, bands);
}

std::vector<double> times(const Matrix3& m, const std::vector<double>& rows, std::size_t bands) {
    std::vector<double> out(3 * bands);
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t b = 0; b < bands; ++b)
            out[i * bands + b] = m(i, 0) * rows[b] + m(i, 1) * rows[bands + b] + m(i, 2) * rows[2 * bands + b];
    return out;
}

Result<OutputWeights> output_weights(const BandSet& bands, const RelightRequest& request) {
    const auto observer = find_observer(request.observer);
    if (!observer) return observer.error();
    const auto output = output_colorimetry(bands, request);
    if (!output) return output.error();
    OutputWeights result;
    result.to_xyz = output->rgb_to_xyz();
    for (const auto& illuminant : request.illuminants) {
        const auto weights = tristimulus_weights(bands, **observer, illuminant, request.normalization);
        if (!weights) return weights.error();
        Matrix3 to_rgb = output->xyz_to_rgb();
        if (request.adaptation != Adaptation::none) {
            Vector3 white = weights->white;
            const double y = white[1];
            for (auto& v : white) v /= y;
            const auto adapt = adaptation_matrix(request.adaptation, white, output->white_xyz());
            if (!adapt)
                return Error{adapt.error().kind, fmt::format("illuminant {}: {}", illuminant.name, adapt.error().message)};
            to_rgb = to_rgb * *adapt;
        }
        const auto rows = times(to_rgb, weights->w, bands.size());
        result.w.insert(result.w.end(), rows.begin(), rows.end());
        result.whites.push_back(weights->white);
    }
    return result;
}

void explain_request(const RelightRequest& request, const OutputWeights& weights, Explanation& out) {
    for (std::size_t k = 0; k < request.illuminants.size(); ++k) {
        const auto& w = weights.whites[k];
        const double sum = w[0] + w[1] + w[2];
        out.push_back({"illuminant", fmt::format("{} ({}), white x {:.4f} y {:.4f}", request.illuminants[k].name,
                                                 request.illuminants[k].title, w[0] / sum, w[1] / sum)});
    }
    if (request.adaptation == Adaptation::none) out.push_back({"adaptation", "none: the light's colour stays"});
}

/// sum over bands of a row of weights times a spectrum.
double dot(const double* w, const double* r, std::size_t n) {
    CompensatedSum sum;
    for (std::size_t b = 0; b < n; ++b) sum.add(w[b] * r[b]);
    return sum.value();
}

std::vector<bool> nonzero_columns(const std::vector<double>& w, std::size_t bands) {
    std::vector<bool> needed(bands, false);
    for (std::size_t i = 0; i < w.size(); ++i)
        if (w[i] != 0) needed[i % bands] = true;
    return needed;
}

}  // namespace

RelightPlan RelightPlan::of_model(std::shared_ptr<const Model> model, std::vector<double> rows, double max_error, const Matrix3& to_xyz) {
    const std::size_t n = model->colorimetry().bands().size();
    RelightPlan plan;
    plan.images_ = rows.size() / (3 * n);
    plan.needed_.assign(static_cast<std::size_t>(model->info().coefficients), true);
    if (const auto* basis = model->basis()) {
        plan.kernel_ = Kernel::matrix;
        for (std::size_t k = 0; k < plan.images_; ++k) {
            Matrix3 m;
            for (std::size_t i = 0; i < 3; ++i)
                for (std::size_t j = 0; j < 3; ++j) m(i, j) = dot(&rows[(3 * k + i) * n], &(*basis)[j * n], n);
            plan.matrices_.push_back(m);
        }
        plan.explanation_.push_back({"kernel", fmt::format("one 3x3 matrix per illuminant, exact: {} is linear in RGB",
                                                           model->info().id)});
        plan.explanation_.push_back({"skipped", fmt::format("forming {} bands per pixel: the integral is inside the matrix", n)});
    } else if (const auto* lattice = model->lattice()) {
        plan.kernel_ = Kernel::lattice;
        auto table = std::make_shared<LatticeTable>();
        table->knots = lattice->knots;
        table->values = 3 * plan.images_;
        const std::size_t vertices = lattice->vertices.size() / lattice->values;
        table->vertices.reserve(vertices * table->values);
        for (std::size_t v = 0; v < vertices; ++v)
            for (std::size_t i = 0; i < table->values; ++i)
                table->vertices.push_back(dot(&rows[i * n], &lattice->vertices[v * lattice->values], n));
        plan.lattice_ = std::make_shared<kernels::LatticeKernel>(*table);
        plan.table_ = std::move(table);
        plan.explanation_.push_back(
            {"kernel", fmt::format("tetrahedral table of {} vertices, exact: {} is linear on each tetrahedron", vertices,
                                   model->info().id)});
        plan.explanation_.push_back({"skipped", fmt::format("forming {} bands per pixel: the integral is inside the table", n)});
    } else {
        plan.kernel_ = Kernel::spectra;
        const std::size_t values = 3 * plan.images_;
        const auto needed = nonzero_columns(rows, n);
        const auto weighing = static_cast<std::size_t>(std::count(needed.begin(), needed.end(), true));
        std::vector<double> weights;
        const auto& id = model->info().id;
        if (const auto fewer = plan::choose_quadrature(*model, rows, to_xyz, max_error)) {
            plan.formed_ = fewer->bands;
            weights = fewer->weights;
            std::vector<double> nm;
            for (const auto b : fewer->bands) nm.push_back(model->colorimetry().bands()[b]);
            plan.explanation_.push_back({"kernel", fmt::format("a spectrum of {} bands per pixel, integrated: {} is not linear", nm.size(), id)});
            plan.explanation_.push_back({"nodes", fmt::format("{} nm, their weights fitted to these illuminants", fmt::join(nm, ", "))});
            plan.explanation_.push_back({"bound", fmt::format("CIE76 {:.3g}: twice the largest seen of {} colours of the whole cube, half of them not fitted to; "
                                                              "{:g} is allowed", fewer->error, fewer->colors, max_error)});
            plan.explanation_.push_back({"skipped", fmt::format("{} of {} bands: {:.0f}% of what forming and summing them costs", n - nm.size(), n,
                                                                100.0 * static_cast<double>(n - nm.size()) / static_cast<double>(n))});
        } else {
            for (std::size_t b = 0; b < n; ++b)
                if (needed[b]) plan.formed_.push_back(b);
            for (std::size_t j = 0; j < values; ++j)
                for (const auto b : plan.formed_) weights.push_back(rows[j * n + b]);
            plan.explanation_.push_back({"kernel", fmt::format("a spectrum of {} bands per pixel, integrated: {} is not linear", weighing, id)});
            if (max_error > 0)
                plan.explanation_.push_back({"bound", model->bands_apart()
                    ? fmt::format("exact: no fifth of the bands can be left out for a CIE76 of {:g} with colours of the whole cube", max_error)
                    : "exact: the method forms all bands at once"});
            else
                plan.explanation_.push_back({"bound", model->bands_apart() ? "exact: every band that these illuminants weigh is a node; --max-error lets fewer do"
                                                                           : "exact: every band that these illuminants weigh is a node"});
            if (weighing < n) plan.explanation_.push_back({"skipped", fmt::format("{} bands of zero weight: never {}", n - weighing,
                                                                                  model->bands_apart() ? "computed" : "summed")});
        }
        for (std::size_t k = 0; k < plan.formed_.size(); ++k)
            for (std::size_t j = 0; j < values; ++j) plan.formed_weights_.push_back(weights[j * plan.formed_.size() + k]);
        plan.weights_ = std::move(rows);
        const auto measure = [&](std::string_view of, const auto& reflectance) {
            const auto b = plan::measure_break_even(
                values, SpectraIntegral(plan.formed_weights_, plan.formed_.size(), values, ColorMemory::inputs, reflectance));
            plan.explanation_.push_back(explain_memory(b, of));
            return std::make_shared<ColorMemoryOwner>(b);
        };
        plan.of_colors_ = measure("colours", [&](std::span<const double> colors, std::span<double> spectra) {
            model->reflectance_in(plan.formed_, colors, spectra);
        });
        plan.of_coefficients_ = std::make_shared<ColorMemoryOwner>();
        if (plan.needed_.size() == ColorMemory::inputs)
            plan.of_coefficients_ = measure("coefficients", [&](std::span<const double> coefficients, std::span<double> spectra) {
                model->reflectance_of_coefficients_in(plan.formed_, coefficients, spectra);
            });
        plan.model_ = std::move(model);
    }
    return plan;
}

RelightPlan RelightPlan::of_bands(std::size_t bands, std::vector<double> rows) {
    RelightPlan plan;
    plan.kernel_ = Kernel::bands;
    plan.images_ = rows.size() / (3 * bands);
    plan.needed_ = nonzero_columns(rows, bands);
    plan.weights_ = std::move(rows);
    const auto used = static_cast<std::size_t>(std::count(plan.needed_.begin(), plan.needed_.end(), true));
    plan.explanation_.push_back({"kernel", fmt::format("weighted sums of {} stored bands, the weights integrated at 1 nm over "
                                                       "each band's linear kernel",
                                                       used)});
    if (used < bands)
        plan.explanation_.push_back({"skipped", fmt::format("{} bands of zero weight: never read", bands - used)});
    return plan;
}

Result<RelightPlan> RelightPlan::for_model(std::shared_ptr<const Model> model, const RelightRequest& request) {
    auto weights = output_weights(model->colorimetry().bands(), request);
    if (!weights) return std::move(weights).error();
    auto plan = of_model(std::move(model), std::move(weights->w), request.max_error, weights->to_xyz);
    explain_request(request, *weights, plan.explanation_);
    return plan;
}

Result<RelightPlan> RelightPlan::for_reflectance(const BandSet& bands, const RelightRequest& request) {
    auto weights = output_weights(bands, request);
    if (!weights) return std::move(weights).error();
    auto plan = of_bands(bands.size(), std::move(weights->w));
    explain_request(request, *weights, plan.explanation_);
    return plan;
}

RelightPlan RelightPlan::as_stored(std::shared_ptr<const Model> model, bool from_bands) {
    const auto& colorimetry = model->colorimetry();
    if (from_bands) return of_bands(colorimetry.bands().size(), colorimetry.sensing_matrix());
    return of_model(model, colorimetry.sensing_matrix());
}

Result<RelightPlan> RelightPlan::for_emission(const BandSet& bands, const RelightRequest& request) {
    const auto observer = find_observer(request.observer);
    if (!observer) return observer.error();
    const auto output = output_colorimetry(bands, request);
    if (!output) return output.error();
    auto weights = emission_weights(bands, **observer);
    if (!(weights.white[1] > 0))
        return Error{ErrorKind::input, fmt::format("emissive bands {}: none lies where {} sees", bands.describe(),
                                                   (*observer)->title)};
    for (auto& w : weights.w) w /= weights.white[1];
    auto plan = of_bands(bands.size(), times(output->xyz_to_rgb(), weights.w, bands.size()));
    plan.explanation_.push_back({"emission", "radiance is reprojected by the observer, not lit"});
    return plan;
}

const Matrix3* RelightPlan::matrix(std::size_t image) const {
    return kernel_ == Kernel::matrix && image < matrices_.size() ? &matrices_[image] : nullptr;
}

void RelightPlan::execute(std::span<const float* const> in, std::size_t n, std::span<float* const> out) const {
    switch (kernel_) {
    case Kernel::matrix:
        for (std::size_t k = 0; k < images_; ++k)
            kernels::matrix3(matrices_[k], {in[0], in[1], in[2]}, n, {out[3 * k], out[3 * k + 1], out[3 * k + 2]});
        return;
    case Kernel::lattice:
        (*lattice_)({in[0], in[1], in[2]}, n, out.data());
        return;
    case Kernel::bands:
        kernels::integrate_bands(in, n, weights_, 3 * images_, out.data());
        return;
    case Kernel::spectra:
        integrate_spectra(*of_coefficients_, in, n, out, [this](std::span<const double> coefficients, std::span<double> spectra) {
            model_->reflectance_of_coefficients_in(formed_, coefficients, spectra);
        });
        return;
    }
}

void RelightPlan::execute_colors(std::array<const float*, 3> rgb, std::size_t n, std::span<float* const> out) const {
    if (kernel_ != Kernel::spectra) return execute(rgb, n, out);
    integrate_spectra(*of_colors_, rgb, n, out, [this](std::span<const double> colors, std::span<double> spectra) {
        model_->reflectance_in(formed_, colors, spectra);
    });
}

void RelightPlan::relit(std::span<const double> rgb, std::span<double> out) const {
    const std::size_t values = 3 * images_, n = rgb.size() / 3;
    if (kernel_ == Kernel::lattice) return kernels::interpolate_lattice(*table_, rgb, out);
    if (kernel_ == Kernel::matrix) {
        for (std::size_t p = 0; p < n; ++p)
            for (std::size_t k = 0; k < images_; ++k) {
                const Vector3 lit = matrices_[k] * Vector3{rgb[3 * p], rgb[3 * p + 1], rgb[3 * p + 2]};
                std::copy(lit.begin(), lit.end(), &out[p * values + 3 * k]);
            }
        return;
    }
    const std::size_t bands = model_->colorimetry().bands().size();
    std::vector<double> spectra(bands * block_pixels);
    for (std::size_t begin = 0; begin < n; begin += block_pixels) {
        const std::size_t count = std::min(block_pixels, n - begin);
        model_->reflectance(rgb.subspan(3 * begin, 3 * count), {spectra.data(), bands * count});
        for (std::size_t p = 0; p < count; ++p)
            for (std::size_t j = 0; j < values; ++j)
                out[(begin + p) * values + j] = dot(&weights_[j * bands], &spectra[p * bands], bands);
    }
}

template <class Reflectance>
void RelightPlan::integrate_spectra(const ColorMemoryOwner& memory, std::span<const float* const> in, std::size_t n,
                                    std::span<float* const> out, const Reflectance& reflectance) const {
    const std::size_t bands = formed_.size(), c = in.size(), values = 3 * images_;
    std::vector<double> numbers;
    std::vector<float> lit(values * block_pixels);
    const SpectraIntegral compute(formed_weights_, bands, values, c, reflectance);
    for (std::size_t begin = 0; begin < n; begin += block_pixels) {
        const std::size_t count = std::min(block_pixels, n - begin);
        if (c == ColorMemory::inputs) {
            ColorMemory::apply(memory, in, begin, count, values, compute, lit.data());
        } else {
            numbers.resize(c * count);
            for (std::size_t p = 0; p < count; ++p)
                for (std::size_t i = 0; i < c; ++i) numbers[p * c + i] = static_cast<double>(in[i][begin + p]);
            compute(numbers, {lit.data(), values * count});
        }
        for (std::size_t j = 0; j < values; ++j)
            for (std::size_t p = 0; p < count; ++p) out[j][begin + p] = lit[p * values + j];
    }
}

Result<StorePlan> StorePlan::make(std::shared_ptr<const Model> model, Store store, PixelType type) {
    const auto& colorimetry = model->colorimetry();
    if (type == PixelType::uint8 && (store != Store::coefficients || !plan::fits_codes(*model)))
        return Error{ErrorKind::usage, store == Store::coefficients
                                           ? fmt::format("8 bits hold coefficients within [0,1], which those of {} are not: expected half or float, or a "
                                                         "method linear in pieces, or peters2019:fourier-srgb",
                                                         model->info().id)
                                           : std::string("8 bits hold coefficients, not spectra: expected half or float")};
    if (type == PixelType::uint16)
        return Error{ErrorKind::usage, fmt::format("spectra and coefficients are stored as half or float, not {}",
                                                   pixel_type_name(type))};
    StorePlan plan(RelightPlan::as_stored(model, store == Store::spectral));
    plan.model_ = model;
    plan.store_ = store;
    plan.type_ = type;
    const auto bands = colorimetry.bands().size();
    if (store == Store::coefficients) {
        plan.names_ = model->coefficient_names();
        plan.explanation_.push_back({"store", fmt::format("{} coefficients per texel as {}{}, the model in the header",
                                                          plan.names_.size(), pixel_type_name(type),
                                                          type != PixelType::uint8 ? ""
                                                          : model->info().pieces != Pieces::nonlinear
                                                              ? " by the curve of sRGB, an 8-bit sRGB texture keeping its codes"
                                                              : " by the curve of sRGB")});
        if (type == PixelType::uint8)
            plan.explanation_.push_back({"skipped", fmt::format("half of the bytes of a texel: {} in place of {}", plan.names_.size(), 2 * plan.names_.size())});
        plan.explanation_.push_back({"skipped", fmt::format("writing {} bands: a reader forms those it needs", bands)});
    } else {
        for (const double nm : colorimetry.bands().wavelengths_nm()) plan.names_.push_back(spectral_channel_name("T", nm));
        plan.explanation_.push_back({"store", fmt::format("{} bands per texel as {}, solved for the weights of this very band set",
                                                          bands, pixel_type_name(type))});
        if (type == PixelType::half) {
            plan.rounder_ = std::make_shared<kernels::HalfSpectraRounder>(colorimetry.sensing_matrix(), bands);
            plan.explanation_.push_back({"rounding", "to half with the errors of a pixel's bands cancelling in its RGB"});
        }
        plan.explanation_.push_back(
            {"kernel", model->basis() ? "linear combination of three spectra" : "spectra evaluated per pixel"});
    }
    if (model->info().pieces == Pieces::nonlinear) {
        const auto b = plan::measure_break_even(plan.names_.size(), StoredNumbers(*model, store, type));
        plan.memory_ = std::make_shared<ColorMemoryOwner>(b);
        plan.explanation_.push_back(explain_memory(b));
    }
    return plan;
}

void StorePlan::store(std::array<const float*, 3> rgb, std::size_t n, std::span<std::byte* const> planes) const {
    const auto emit = [&](const float* from, std::size_t count, std::size_t channel, std::size_t at) {
        if (type_ == PixelType::half)
            kernels::float_to_half(from, count, reinterpret_cast<std::uint16_t*>(planes[channel]) + at, 1);
        else if (type_ == PixelType::uint8)
            plan::encode_codes(from, count, reinterpret_cast<std::uint8_t*>(planes[channel]) + at);
        else
            std::copy_n(from, count, reinterpret_cast<float*>(planes[channel]) + at);
    };
    if (store_ == Store::spectral) return store_bands(rgb, n, planes);
    if (store_ == Store::coefficients && model_->info().pieces != Pieces::nonlinear) {
        for (std::size_t i = 0; i < 3; ++i) emit(rgb[i], n, i, 0);
        return;
    }
    const std::size_t values = planes.size();
    std::vector<float> coefficients(values * block_pixels), plane(block_pixels);
    const StoredNumbers compute(*model_, store_, type_);
    for (std::size_t begin = 0; begin < n; begin += block_pixels) {
        const std::size_t count = std::min(block_pixels, n - begin);
        ColorMemory::apply(*memory_, rgb, begin, count, values, compute, coefficients.data());
        for (std::size_t i = 0; i < values; ++i) {
            for (std::size_t p = 0; p < count; ++p) plane[p] = coefficients[p * values + i];
            emit(plane.data(), count, i, begin);
        }
    }
}

void StorePlan::store_bands(std::array<const float*, 3> rgb, std::size_t n, std::span<std::byte* const> planes) const {
    const std::size_t bands = planes.size();
    const bool half = type_ == PixelType::half;
    // Halves are rounded together, so their floats pass through a block; floats go where they stay.
    std::vector<float> block(half ? bands * block_pixels : 0);
    std::vector<double> colors, computed;
    std::vector<float> spectra;
    const bool nonlinear = model_->info().pieces == Pieces::nonlinear;
    if (!model_->basis() && !nonlinear) {
        colors.resize(3 * block_pixels);
        computed.resize(bands * block_pixels);
    }
    if (nonlinear) spectra.resize(bands * block_pixels);
    const StoredNumbers compute(*model_, Store::spectral, type_);
    std::vector<float*> out(bands);
    std::vector<std::uint16_t*> halves(bands);
    for (std::size_t begin = 0; begin < n; begin += block_pixels) {
        const std::size_t count = std::min(block_pixels, n - begin);
        for (std::size_t b = 0; b < bands; ++b)
            out[b] = half ? &block[b * block_pixels] : reinterpret_cast<float*>(planes[b]) + begin;
        if (model_->basis()) {
            kernels::combine_basis({rgb[0] + begin, rgb[1] + begin, rgb[2] + begin}, count, *model_->basis(), 0, bands, out.data());
        } else if (nonlinear) {
            ColorMemory::apply(*memory_, rgb, begin, count, bands, compute, spectra.data());
            for (std::size_t b = 0; b < bands; ++b)
                for (std::size_t p = 0; p < count; ++p) out[b][p] = spectra[p * bands + b];
        } else {
            // As many spectra at a time as stay in the first cache while they are turned into planes.
            constexpr std::size_t tile = 32;
            for (std::size_t first = 0; first < count; first += tile) {
                const std::size_t some = std::min(tile, count - first);
                for (std::size_t p = 0; p < some; ++p)
                    for (std::size_t i = 0; i < 3; ++i) colors[3 * p + i] = rgb[i][begin + first + p];
                model_->reflectance({colors.data(), 3 * some}, {computed.data(), bands * some});
                for (std::size_t b = 0; b < bands; ++b)
                    for (std::size_t p = 0; p < some; ++p) out[b][first + p] = static_cast<float>(computed[p * bands + b]);
            }
        }
        if (!half) continue;
        for (std::size_t b = 0; b < bands; ++b) halves[b] = reinterpret_cast<std::uint16_t*>(planes[b]) + begin;
        (*rounder_)(out.data(), count, halves.data());
    }
}

void StorePlan::reproject(std::span<const std::byte* const> planes, std::size_t n, std::array<float*, 3> rgb) const {
    std::vector<float> widened;
    std::vector<const float*> in(planes.size());
    if (type_ != PixelType::float32) widened.resize(planes.size() * block_pixels);
    for (std::size_t begin = 0; begin < n; begin += block_pixels) {
        const std::size_t count = std::min(block_pixels, n - begin);
        for (std::size_t i = 0; i < planes.size(); ++i) {
            if (type_ != PixelType::float32) {
                float* out = &widened[i * block_pixels];
                if (type_ == PixelType::half)
                    kernels::half_to_float(reinterpret_cast<const std::uint16_t*>(planes[i]) + begin, 1, count, out);
                else
                    kernels::decode_codes(reinterpret_cast<const std::uint8_t*>(planes[i]) + begin, 1, count, plan::code_table(), out);
                in[i] = out;
            } else {
                in[i] = reinterpret_cast<const float*>(planes[i]) + begin;
            }
        }
        const std::array<float*, 3> out{rgb[0] + begin, rgb[1] + begin, rgb[2] + begin};
        reader_.execute(in, count, out);
    }
}

}  // namespace spectex
