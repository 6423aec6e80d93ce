#include "plan/bounded_store.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "kernels/convert.h"
#include "kernels/mantissa.h"

namespace spectex {
namespace {

constexpr std::size_t checked_at_once = 1024;

/// Colours are checked as floats, whose rounding moves a CIE76 by less than this; a bound is kept with so much room.
constexpr double check_room = 1e-4;

std::array<float*, 3> three(std::vector<float>& v, std::size_t group) {
    return {&v[(3 * group) * checked_at_once], &v[(3 * group + 1) * checked_at_once], &v[(3 * group + 2) * checked_at_once]};
}
std::array<const float*, 3> constant(const std::array<float*, 3>& p) { return {p[0], p[1], p[2]}; }

}  // namespace

Result<BoundedStore> BoundedStore::make(StorePlan plan, std::shared_ptr<const Model> model, Store store, double bound,
                                        const std::vector<Illuminant>& lights, std::shared_ptr<const Model> reference,
                                        bool full) {
    if (!(bound > 0) || !std::isfinite(bound))
        return Error{ErrorKind::usage, fmt::format("a largest error of {}: expected a CIE76 above 0", bound)};
    auto exact = StorePlan::make(model, store, PixelType::float32);
    if (!exact) return std::move(exact).error();
    BoundedStore result(std::move(plan), *std::move(exact));
    const auto& colorimetry = model->colorimetry();
    result.kernels_.emplace_back(Metric::cie76, colorimetry.rgb_to_xyz(), colorimetry.rgb_to_xyz(), colorimetry.white_xyz());
    if (!lights.empty()) {
        RelightRequest request;
        request.observer = colorimetry.observer().id;
        request.illuminants = lights;
        auto relit = store == Store::spectral ? RelightPlan::for_reflectance(colorimetry.bands(), request)
                                              : RelightPlan::for_model(model, request);
        if (!relit) return std::move(relit).error();
        result.relit_ = *std::move(relit);
        const auto& truth = reference ? reference : model;
        if (reference) {
            auto own = RelightPlan::for_model(reference, request);
            if (!own) return std::move(own).error();
            result.relit_reference_ = *std::move(own);
        }
        // Both sides come as linear BT.709; the reference's bands say what that is.
        const auto output = Colorimetry::make({request.observer, "", request.output_space, RgbMatrix::integrated},
                                              truth->colorimetry().bands());
        if (!output) return output.error();
        for (const auto& light : lights) {
            const auto weights = tristimulus_weights(truth->colorimetry().bands(), colorimetry.observer(), light,
                                                     Normalization::luminance);
            if (!weights) return weights.error();
            result.kernels_.emplace_back(Metric::cie76, output->rgb_to_xyz(), output->rgb_to_xyz(), weights->white);
        }
    }
    result.model_ = std::move(model);
    result.reference_ = std::move(reference);
    result.store_ = store;
    result.bound_ = bound;
    result.inner_ = bound - std::min(check_room, bound / 10);
    result.lights_ = lights;
    result.full_ = full;
    return result;
}

void BoundedStore::Outcome::add(const Outcome& other) {
    for (std::size_t i = 0; i < kept_bits.size(); ++i) kept_bits[i] += other.kept_bits[i];
    worst.resize(std::max(worst.size(), other.worst.size()), 0);
    for (std::size_t i = 0; i < other.worst.size(); ++i) worst[i] = std::max(worst[i], other.worst[i]);
}

struct BoundedStore::Workspace {
    std::vector<float> exact, rounded;      // [stored][checked_at_once], the pixels still undecided first
    std::vector<float> expected, got;       // [checks][3][checked_at_once]
    std::vector<float> errors;              // [checks][checked_at_once]
    std::vector<std::uint16_t> halves;      // [stored][checked_at_once]
    std::vector<std::uint32_t> undecided;   // their places in the block
    std::vector<std::uint32_t> held, failed;  // of the undecided, by the last check
    std::vector<std::vector<float>> coefficients;

    Workspace(std::size_t stored, std::size_t checks)
        : exact(stored * checked_at_once), rounded(stored * checked_at_once), expected(3 * checks * checked_at_once),
          got(3 * checks * checked_at_once), errors(checks * checked_at_once), halves(stored * checked_at_once),
          undecided(checked_at_once), held(checked_at_once), failed(checked_at_once) {}
};

std::optional<BoundedStore::Failure> BoundedStore::store(std::array<const float*, 3> rgb, std::size_t n,
                                                         std::span<std::byte* const> planes, Outcome& outcome,
                                                         std::span<const std::uint32_t> times) const {
    const std::size_t stored = planes.size(), checks = kernels_.size(), images = lights_.size();
    const bool half = plan_.type() == PixelType::half;
    const int most = half ? kernels::half_mantissa_bits : kernels::float_mantissa_bits;
    const int least = full_ ? most : images > 0 || store_ == Store::coefficients ? 0 : least_bits_without_lights;
    const std::size_t size = pixel_bytes(plan_.type());
    Workspace w(stored, checks);
    outcome.worst.resize(std::max(outcome.worst.size(), checks), 0);

    std::vector<const float*> in(stored), tried(stored);
    std::vector<float*> exact(stored), rounded(stored);
    std::vector<std::byte*> exact_bytes(stored);
    for (std::size_t i = 0; i < stored; ++i) {
        exact[i] = &w.exact[i * checked_at_once];
        rounded[i] = &w.rounded[i * checked_at_once];
        exact_bytes[i] = reinterpret_cast<std::byte*>(exact[i]);
        in[i] = exact[i];
        tried[i] = rounded[i];
    }
    std::vector<const std::byte*> tried_bytes(stored), in_bytes(stored);
    for (std::size_t i = 0; i < stored; ++i) {
        tried_bytes[i] = reinterpret_cast<const std::byte*>(tried[i]);
        in_bytes[i] = reinterpret_cast<const std::byte*>(in[i]);
    }
    std::vector<float*> relit_out, relit_expected;
    for (std::size_t k = 0; k < images; ++k) {
        for (float* p : three(w.got, k + 1)) relit_out.push_back(p);
        for (float* p : three(w.expected, k + 1)) relit_expected.push_back(p);
    }

    /// Differences of the first `m` pixels of `rounded`; the worst check of each over the bound.
    const auto measure = [&](std::size_t m) {
        exact_.reproject(tried_bytes, m, three(w.got, 0));
        if (relit_) relit_->execute(tried, m, relit_out);
        for (std::size_t c = 0; c < checks; ++c)
            kernels_[c](constant(three(w.expected, c)), constant(three(w.got, c)), m, &w.errors[c * checked_at_once]);
    };
    const auto holds = [&](std::size_t p) {
        for (std::size_t c = 0; c < checks; ++c)
            if (!(w.errors[c * checked_at_once + p] <= inner_)) return false;
        return true;
    };
    std::size_t block_begin = 0;
    const auto note = [&](std::size_t p, int bits) {
        outcome.kept_bits[static_cast<std::size_t>(bits)] += times.empty() ? 1 : times[block_begin + w.undecided[p]];
        for (std::size_t c = 0; c < checks; ++c)
            outcome.worst[c] = std::max(outcome.worst[c], static_cast<double>(w.errors[c * checked_at_once + p]));
    };
    /// The first `m` pixels of `rounded` as the type stores them, which loses nothing more.
    const auto finish = [&](std::size_t m) {
        if (!half) return;
        for (std::size_t i = 0; i < stored; ++i) kernels::float_to_half(rounded[i], m, &w.halves[i * checked_at_once], 1);
    };
    /// The pixels w.held of `rounded` to their places: row by row, since the rows' distance, a power of two, would put all
    /// samples of a pixel into one set of the cache.
    const auto write = [&](std::size_t held, std::size_t begin) {
        for (std::size_t i = 0; i < stored; ++i) {
            if (half) {
                auto* const out = reinterpret_cast<std::uint16_t*>(planes[i]) + begin;
                for (std::size_t j = 0; j < held; ++j) out[w.undecided[w.held[j]]] = w.halves[i * checked_at_once + w.held[j]];
            } else {
                auto* const out = reinterpret_cast<float*>(planes[i]) + begin;
                for (std::size_t j = 0; j < held; ++j) out[w.undecided[w.held[j]]] = rounded[i][w.held[j]];
            }
        }
    };
    /// The pixels w.failed to the front, with what they are compared with.
    const auto move_up = [&](std::size_t failed) {
        const auto row = [&](auto* values) {
            for (std::size_t j = 0; j < failed; ++j) values[j] = values[w.failed[j]];
        };
        for (std::size_t i = 0; i < stored; ++i) row(exact[i]);
        for (std::size_t i = 0; i < 3 * checks; ++i) row(&w.expected[i * checked_at_once]);
        row(w.undecided.data());
    };

    for (std::size_t begin = 0; begin < n; begin += checked_at_once) {
        const std::size_t count = std::min(checked_at_once, n - begin);
        block_begin = begin;
        const std::array<const float*, 3> colors{rgb[0] + begin, rgb[1] + begin, rgb[2] + begin};
        exact_.store(colors, count, exact_bytes);
        if (model_->info().exact)
            for (std::size_t i = 0; i < 3; ++i) std::copy_n(colors[i], count, three(w.expected, 0)[i]);
        else
            exact_.reproject(in_bytes, count, three(w.expected, 0));
        if (relit_reference_) {
            std::vector<const float*> inputs{colors[0], colors[1], colors[2]};
            if (reference_->info().pieces == Pieces::nonlinear) {
                std::vector<double> c(3 * count), k(static_cast<std::size_t>(reference_->info().coefficients) * count);
                for (std::size_t p = 0; p < count; ++p)
                    for (std::size_t i = 0; i < 3; ++i) c[3 * p + i] = colors[i][p];
                reference_->coefficients(c, k);
                const std::size_t each = k.size() / count;
                w.coefficients.assign(each, std::vector<float>(count));
                inputs.clear();
                for (std::size_t i = 0; i < each; ++i) {
                    for (std::size_t p = 0; p < count; ++p) w.coefficients[i][p] = static_cast<float>(k[p * each + i]);
                    inputs.push_back(w.coefficients[i].data());
                }
            }
            relit_reference_->execute(inputs, count, relit_expected);
        } else if (relit_) {
            relit_->execute(in, count, relit_expected);
        }
        std::iota(w.undecided.begin(), w.undecided.begin() + static_cast<std::ptrdiff_t>(count), 0u);

        std::size_t left = count;
        for (int bits = least; bits <= most && left > 0; ++bits) {
            for (std::size_t i = 0; i < stored; ++i) kernels::round_mantissa(in[i], left, bits, half, rounded[i]);
            measure(left);
            finish(left);
            std::size_t held = 0, failed = 0;
            for (std::size_t p = 0; p < left; ++p) {
                if (holds(p)) {
                    note(p, bits);
                    w.held[held++] = static_cast<std::uint32_t>(p);
                } else {
                    w.failed[failed++] = static_cast<std::uint32_t>(p);
                }
            }
            write(held, begin);
            if (held > 0) move_up(failed);
            left = failed;
        }
        if (left == 0) continue;

        // What no plain rounding holds gets the full precision of the type, its errors cancelling.
        std::vector<float> colors_left(3 * left);
        for (std::size_t p = 0; p < left; ++p)
            for (std::size_t i = 0; i < 3; ++i) colors_left[i * left + p] = colors[i][w.undecided[p]];
        std::vector<std::byte> full_bytes(stored * left * size);
        std::vector<std::byte*> full(stored);
        for (std::size_t i = 0; i < stored; ++i) full[i] = &full_bytes[i * left * size];
        plan_.store({&colors_left[0], &colors_left[left], &colors_left[2 * left]}, left, full);
        for (std::size_t i = 0; i < stored; ++i) {
            if (half)
                kernels::half_to_float(reinterpret_cast<const std::uint16_t*>(full[i]), 1, left, rounded[i]);
            else
                std::copy_n(reinterpret_cast<const float*>(full[i]), left, rounded[i]);
        }
        finish(left);
        measure(left);
        for (std::size_t p = 0; p < left; ++p) {
            if (!holds(p)) {
                Failure failure{begin + w.undecided[p], 0, 0};
                for (std::size_t c = 0; c < checks; ++c)
                    if (const double e = w.errors[c * checked_at_once + p]; !(e <= failure.error)) failure = {failure.pixel, c, e};
                return failure;
            }
            note(p, most);
            w.held[p] = static_cast<std::uint32_t>(p);
        }
        write(left, begin);
    }
    return std::nullopt;
}

Explanation BoundedStore::explanation() const {
    std::string names;
    for (const auto& light : lights_) names += (names.empty() ? "" : ", ") + light.name;
    Explanation lines;
    lines.push_back({"bound", fmt::format("CIE76 {:g} of every pixel's round trip{}", bound_,
                                          names.empty() ? std::string() : fmt::format(" and of its colour under {}", names))});
    if (full_) return lines;
    lines.push_back({"rounding", lights_.empty() && store_ == Store::spectral
                                     ? fmt::format("mantissas of each pixel to the fewest bits, at least {}, that keep the bound: "
                                                   "lights not named by --for are not bounded",
                                                   least_bits_without_lights)
                                     : std::string("mantissas of each pixel to the fewest bits that keep the bound")});
    return lines;
}

}  // namespace spectex
