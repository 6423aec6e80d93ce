#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "spectex/spectral.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

/// Power at a whole nanometre: linear between the table's points; where the table is finer than 1 nm, its average with a
/// triangle of 2 nm base, so that no line falls between two samples.
class PowerAtNanometre {
public:
    explicit PowerAtNanometre(const SpectralDistribution& power) : power_(power) {
        const auto& x = power.wavelengths_nm();
        for (std::size_t i = 1; i < x.size(); ++i) finest_ = std::min(finest_, x[i] - x[i - 1]);
        average_ = finest_ < 1 - 1e-9;
    }
    double operator()(double nm) const { return average_ ? averaged(nm) : power_.at(nm, Extrapolation::zero); }

private:
    /// Integral of the piecewise linear table times max(0, 1 - |l - nm|): on each piece both factors are linear, so
    /// Simpson's rule is exact.
    double averaged(double nm) const {
        const auto& x = power_.wavelengths_nm();
        const auto& v = power_.values();
        CompensatedSum sum;
        auto i = static_cast<std::size_t>(std::lower_bound(x.begin(), x.end(), nm - 1) - x.begin());
        if (i == 0) i = 1;
        for (; i < x.size() && x[i - 1] < nm + 1; ++i) {
            const auto piece = [&](double from, double to) {
                from = std::max(from, x[i - 1]);
                to = std::min(to, x[i]);
                if (to <= from) return;
                const auto value = [&](double l) {
                    const double t = (l - x[i - 1]) / (x[i] - x[i - 1]);
                    return ((1 - t) * v[i - 1] + t * v[i]) * std::max(0.0, 1 - std::fabs(l - nm));
                };
                sum.add((to - from) / 6 * (value(from) + 4 * value((from + to) / 2) + value(to)));
            };
            piece(nm - 1, nm);
            piece(nm, nm + 1);
        }
        return sum.value();
    }

    const SpectralDistribution& power_;
    double finest_ = 1e9;
    bool average_ = false;
};

/// Sums power(l) cmf(l) h_b(l) over whole nanometres in [front, back]: [3][bands], and its row sums.
template <class Power>
TristimulusWeights quadrature(const BandSet& bands, const Observer& observer, const Power& power) {
    const std::size_t n = bands.size();
    std::vector<CompensatedSum> sums(3 * n);
    std::array<CompensatedSum, 3> white;
    const std::array<const std::vector<double>*, 3> cmf{&observer.x_bar, &observer.y_bar, &observer.z_bar};
    const auto cmf_size = static_cast<double>(observer.x_bar.size());
    std::size_t b = 0;
    for (double nm = std::ceil(bands.front()); nm <= std::floor(bands.back()); ++nm) {
        const double index = nm - observer.start_nm;
        if (index < 0 || index >= cmf_size) continue;
        const double s = power(nm);
        if (s == 0) continue;
        while (b + 2 < n && bands[b + 1] <= nm) ++b;
        const double t = (nm - bands[b]) / (bands[b + 1] - bands[b]);
        for (std::size_t c = 0; c < 3; ++c) {
            const double v = s * (*cmf[c])[static_cast<std::size_t>(index)];
            sums[c * n + b].add((1 - t) * v);
            sums[c * n + b + 1].add(t * v);
            white[c].add(v);
        }
    }
    TristimulusWeights out;
    out.w.reserve(3 * n);
    for (const auto& sum : sums) out.w.push_back(sum.value());
    for (std::size_t c = 0; c < 3; ++c) out.white[c] = white[c].value();
    return out;
}

/// Y of CIE D65 (100 at 560 nm) over the whole range of an observer.
Result<double> d65_luminance(const Observer& observer) {
    const auto d65 = parse_illuminant("D65");
    if (!d65) return d65.error();
    const PowerAtNanometre power(d65->power);
    CompensatedSum sum;
    for (std::size_t i = 0; i < observer.y_bar.size(); ++i)
        sum.add(power(observer.start_nm + static_cast<double>(i)) * observer.y_bar[i]);
    return sum.value();
}

}  // namespace

Result<TristimulusWeights> tristimulus_weights(const BandSet& bands, const Observer& observer, const Illuminant& illuminant,
                                               Normalization normalization) {
    const auto& values = illuminant.power.values();
    const double peak = values.empty() ? 0 : *std::max_element(values.begin(), values.end());
    // Tables of any scale, 1e-30 as 1e30: the peak becomes 1 before anything is summed.
    const PowerAtNanometre power(illuminant.power);
    auto out = quadrature(bands, observer, [&](double nm) { return peak > 0 ? power(nm) / peak : 0.0; });
    if (!(out.white[1] > 0) || !std::isfinite(out.white[1]))
        return Error{ErrorKind::input,
                     fmt::format("illuminant {}: no power that {} sees between {} and {} nm: expected some, to normalise by",
                                 illuminant.name, observer.title, bands.front(), bands.back())};
    double scale = 1 / out.white[1];
    if (normalization == Normalization::none) {
        const auto d65 = d65_luminance(observer);
        if (!d65) return d65.error();
        scale = peak / *d65;
    }
    for (auto& w : out.w) w *= scale;
    for (auto& w : out.white) w *= scale;
    if (normalization == Normalization::luminance) out.white[1] = 1;
    return out;
}

TristimulusWeights emission_weights(const BandSet& bands, const Observer& observer) {
    return quadrature(bands, observer, [](double) { return 1.0; });
}

Result<Colorimetry> Colorimetry::make(const ColorimetrySpec& spec, const BandSet& bands) {
    const auto space = find_rgb_space(spec.rgb_space);
    if (!space) return space.error();
    auto illuminant = parse_illuminant(spec.illuminant.empty() ? space->illuminant : spec.illuminant);
    if (!illuminant) return std::move(illuminant).error();
    return make(spec, bands, *illuminant);
}

Result<Colorimetry> Colorimetry::make(const ColorimetrySpec& spec, const BandSet& bands, const Illuminant& illuminant) {
    auto space = find_rgb_space(spec.rgb_space);
    if (!space) return std::move(space).error();
    auto observer = find_observer(spec.observer);
    if (!observer) return std::move(observer).error();
    auto weights = tristimulus_weights(bands, **observer, illuminant, Normalization::luminance);
    if (!weights) return std::move(weights).error();

    Colorimetry c;
    c.bands_ = bands;
    c.observer_ = *observer;
    c.illuminant_ = illuminant;
    c.space_ = *space;
    c.matrix_kind_ = spec.matrix;
    c.weights_ = *std::move(weights);
    const Vector3 white = spec.matrix == RgbMatrix::standard ? xyz_from_xy(space->white_xy[0], space->white_xy[1])
                                                             : c.weights_.white;
    c.rgb_to_xyz_ = rgb_to_xyz_matrix(c.space_, white);
    c.xyz_to_rgb_ = c.rgb_to_xyz_.inverse();
    const std::size_t n = bands.size();
    c.a_.resize(3 * n);
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t b = 0; b < n; ++b) {
            long double sum = 0;
            for (std::size_t k = 0; k < 3; ++k)
                sum += static_cast<long double>(c.xyz_to_rgb_(i, k)) * static_cast<long double>(c.weights_.w[k * n + b]);
            c.a_[i * n + b] = static_cast<double>(sum);
        }
    for (const double a : c.a_)
        if (!std::isfinite(a))
            return Error{ErrorKind::input, fmt::format("illuminant {} gives no usable white for {}: its chromaticity makes the "
                                                       "RGB-to-XYZ matrix singular",
                                                       illuminant.name, c.space_.name)};
    return c;
}

Vector3 Colorimetry::rgb_of(std::span<const double> reflectance) const {
    const std::size_t n = bands_.size();
    Vector3 rgb{};
    for (std::size_t i = 0; i < 3; ++i) {
        CompensatedSum sum;
        for (std::size_t b = 0; b < n; ++b) sum.add(a_[i * n + b] * reflectance[b]);
        rgb[i] = sum.value();
    }
    return rgb;
}

std::string Colorimetry::describe() const {
    return fmt::format("{}, {}, {}, {}, {}", bands_.describe(), observer_->title, illuminant_.name, space_.name,
                       matrix_kind_ == RgbMatrix::integrated ? "integrated white" : "white of the standard");
}

}  // namespace spectex
