#include <fmt/format.h>
#include <tbb/task_arena.h>

#include <cmath>

#include "parallel.h"
#include "spectex/color.h"
#include "spectex/evaluation.h"

namespace spectex {
namespace {

constexpr std::size_t wavelengths_per_sample = 4;
/// Rows of the texture that are handled together: enough for all processors.
constexpr int lines_at_once = 64;
/// Pixels whose spectra are formed together: they stay in the cache.
constexpr std::size_t colors_at_once = 256;

/// splitmix64's finalizer (Steele, Lea and Flood 2014): any two inputs give unrelated outputs.
std::uint64_t mixed(std::uint64_t z) {
    z += 0x9e3779b97f4a7c15;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9;
    z = (z ^ z >> 27) * 0x94d049bb133111eb;
    return z ^ z >> 31;
}

/// Estimates the integrals of a spectrum in bands against three weights at whole nanometres.
class HeroEstimator {
public:
    static Result<HeroEstimator> make(const Colorimetry& c) {
        const auto& bands = c.bands();
        HeroEstimator e;
        const int first = static_cast<int>(std::ceil(bands.front())), last = static_cast<int>(std::floor(bands.back()));
        const auto grid = BandSet::parse(fmt::format("{}:{}:1", first, last));
        if (!grid) return grid.error();
        const auto weights = tristimulus_weights(*grid, c.observer(), c.illuminant(), Normalization::luminance);
        if (!weights) return weights.error();
        const Matrix3 to_rgb = c.rgb_to_xyz().inverse();
        const std::size_t n = grid->size();
        std::size_t band = 0;
        for (std::size_t i = 0; i < n; ++i) {
            const double nm = (*grid)[i];
            while (band + 2 < bands.size() && bands[band + 1] <= nm) ++band;
            const Vector3 rgb = to_rgb * Vector3{weights->w[i], weights->w[n + i], weights->w[2 * n + i]};
            // Every nanometre is as likely as another.
            const double scale = static_cast<double>(n) / static_cast<double>(wavelengths_per_sample);
            const double place = bands.size() > 1 ? (nm - bands[band]) / (bands[band + 1] - bands[band]) : 0;
            e.nodes_.push_back({static_cast<std::uint32_t>(band), static_cast<float>(place),
                                {static_cast<float>(scale * rgb[0]), static_cast<float>(scale * rgb[1]),
                                 static_cast<float>(scale * rgb[2])}});
        }
        for (std::size_t j = 0; j < wavelengths_per_sample; ++j) e.offsets_[j] = (j * n) / wavelengths_per_sample;
        return e;
    }

    /// @param spectrum  [bands]. @param key  of the pixel's own random numbers.
    std::array<float, 3> operator()(const float* spectrum, std::uint64_t key, int samples) const {
        std::array<float, 3> sum{};
        const std::size_t n = nodes_.size();
        for (int s = 0; s < samples; ++s) {
            const std::uint64_t random = mixed(key + static_cast<std::uint64_t>(s));
            const auto hero = static_cast<std::size_t>((random >> 32) * n >> 32);
            for (const std::size_t offset : offsets_) {
                std::size_t i = hero + offset;
                i -= i >= n ? n : 0;
                const Node& node = nodes_[i];
                const float a = spectrum[node.band], b = spectrum[node.band + 1], r = a + node.place * (b - a);
                for (std::size_t c = 0; c < 3; ++c) sum[c] += node.weight[c] * r;
            }
        }
        for (float& v : sum) v /= static_cast<float>(samples);
        return sum;
    }

private:
    struct Node {
        std::uint32_t band;
        float place;  // between the band and the next
        std::array<float, 3> weight;
    };
    std::vector<Node> nodes_;
    std::array<std::size_t, wavelengths_per_sample> offsets_{};
};

/// Every colour once, so that it looks well: tiles of red across and green down, mirrored so that they meet in equal colours,
/// with blue rising from tile to tile. The low bits of blue fill small squares, too small to be seen.
class GamutTexture {
public:
    explicit GamutTexture(unsigned bits) : bits_(bits), tile_(std::min(2u, bits / 2)), cell_(bits / 2 - tile_) {}
    int width() const { return 1 << (bits_ + tile_ + cell_); }
    std::array<std::uint32_t, 3> code(std::uint32_t x, std::uint32_t y) const {
        const std::uint32_t last = (1u << bits_) - 1, tiles = 1u << tile_, inside = (1u << cell_) - 1;
        const std::uint32_t column = x >> (bits_ + cell_), row = y >> (bits_ + cell_);
        const std::uint32_t red = x >> cell_ & last, green = y >> cell_ & last;
        const std::uint32_t tile = row * tiles + column;
        return {column % 2 ? last - red : red, row % 2 ? last - green : green,
                (tile << cell_ | (y & inside)) << cell_ | (x & inside)};
    }

private:
    unsigned bits_, tile_, cell_;  // of a component; of the number of tiles along an axis; of a small square's side
};

/// Which pixels of a panel a texel overlaps along one axis, and with how much of each.
class Shrinker {
public:
    Shrinker(int texture, int panel) : scale_(static_cast<double>(panel) / texture), panel_(static_cast<std::size_t>(panel)) {}
    std::size_t panel() const { return panel_; }
    template <class Take>
    void spread(std::size_t x, const Take& take) const {
        const double from = static_cast<double>(x) * scale_, to = static_cast<double>(x + 1) * scale_;
        for (auto p = static_cast<std::size_t>(from); p < panel_ && static_cast<double>(p) < to; ++p) {
            const double w = std::min(to, static_cast<double>(p + 1)) - std::max(from, static_cast<double>(p));
            if (w > 0) take(p, w);
        }
    }
    /// One row of the texture, [texels][channels], to the panel's width.
    void shrink(std::span<const float> row, std::size_t channels, std::vector<float>& out) const {
        std::vector<double> sum(panel_ * channels);
        for (std::size_t x = 0; x * channels < row.size(); ++x)
            spread(x, [&](std::size_t p, double w) {
                for (std::size_t c = 0; c < channels; ++c) sum[p * channels + c] += w * static_cast<double>(row[x * channels + c]);
            });
        out.assign(sum.begin(), sum.end());
    }

private:
    double scale_;
    std::size_t panel_;
};

/// Means over the texels of each pixel of a square panel, fed rows that are as wide as the panel.
class Panel {
public:
    Panel(const Shrinker& shrinker, std::size_t channels)
        : shrinker_(shrinker), sum_(shrinker.panel() * shrinker.panel() * channels) {}
    void add(std::size_t y, const std::vector<float>& row) {
        shrinker_.spread(y, [&](std::size_t p, double w) {
            for (std::size_t i = 0; i < row.size(); ++i) sum_[p * row.size() + i] += w * static_cast<double>(row[i]);
        });
    }
    std::vector<float> result() const { return {sum_.begin(), sum_.end()}; }

private:
    Shrinker shrinker_;
    std::vector<double> sum_;
};

using Planes = std::array<std::vector<float>, 3>;
std::array<const float*, 3> pointers(const Planes& p) { return {p[0].data(), p[1].data(), p[2].data()}; }

/// Interleaved, as an image of [0,1] keeps it.
void display(const Planes& planes, std::vector<float>& out) {
    const std::size_t n = planes[0].size();
    out.resize(3 * n);
    for (std::size_t x = 0; x < n; ++x)
        for (std::size_t c = 0; c < 3; ++c) {
            const float v = planes[c][x];
            out[3 * x + c] = v > 0 ? std::min(v, 1.0f) : 0.0f;
        }
}

/// One row of the texture, and what a method makes of it.
struct MethodRow {
    Planes clean, noisy;
    std::vector<float> noise, distortion, shrunk, shrunk_noise, shrunk_distortion;
};
struct Row {
    Planes truth;
    std::vector<float> shrunk;
    std::vector<MethodRow> methods;
};

}  // namespace

Result<GamutRendering> render_gamut(const Colorimetry& colorimetry, const GamutRenderingOptions& options) {
    const auto wrong = [](std::string what) { return Error{ErrorKind::usage, std::move(what)}; };
    if (options.methods.empty()) return wrong("gamut: expected at least one method");
    if (options.bits < 2 || options.bits > 8 || options.bits % 2 != 0)
        return wrong(fmt::format("gamut: {} bits: expected 2, 4, 6 or 8", options.bits));
    if (options.samples_per_pixel < 1) return wrong(fmt::format("gamut: {} samples: expected 1 or more", options.samples_per_pixel));
    if (options.panel < 1 || options.panel > 16384) return wrong(fmt::format("gamut: panel of {}: expected 1 to 16384", options.panel));
    const auto bits = static_cast<unsigned>(options.bits);
    const GamutTexture texture(bits);
    const int width = texture.width();
    const auto n = static_cast<std::size_t>(width);

    std::vector<std::shared_ptr<const Model>> models;
    GamutRendering out;
    out.panel = options.panel;
    out.texels = static_cast<std::uint64_t>(n) * n;
    std::vector<DifferenceAccumulator> noise(options.methods.size()), distortion(options.methods.size());
    for (const auto& id : options.methods) {
        auto model = make_model(id, colorimetry);
        if (!model) return std::move(model).error();
        models.push_back(*std::move(model));
        out.methods.push_back({id, models.back()->info().title, models.back()->info().source, {}, {}, {}, {}, {}});
    }
    const auto estimator = HeroEstimator::make(colorimetry);
    if (!estimator) return estimator.error();
    const DifferenceKernel difference(Metric::cie76, colorimetry.rgb_to_xyz(), colorimetry.rgb_to_xyz(), colorimetry.white_xyz());
    std::vector<double> linear;
    const double last = static_cast<double>((1u << bits) - 1);
    for (unsigned v = 0; v < 1u << bits; ++v) linear.push_back(srgb_decode(v / last));
    const std::size_t bands = colorimetry.bands().size();
    const Shrinker shrinker(width, options.panel);

    const auto render = [&](Row& row, int y) {
        std::vector<double> rgb(3 * n), spectra(colors_at_once * bands);
        std::vector<float> spectrum(bands + 1), shown;
        for (std::size_t x = 0; x < n; ++x) {
            const auto code = texture.code(static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y));
            for (std::size_t c = 0; c < 3; ++c) {
                rgb[3 * x + c] = linear[code[c]];
                row.truth[c][x] = static_cast<float>(rgb[3 * x + c]);
            }
        }
        display(row.truth, shown);
        shrinker.shrink(shown, 3, row.shrunk);
        for (std::size_t m = 0; m < models.size(); ++m) {
            MethodRow& mine = row.methods[m];
            for (std::size_t begin = 0; begin < n; begin += colors_at_once) {
                const std::size_t count = std::min(colors_at_once, n - begin);
                const std::span<double> formed(spectra.data(), count * bands);
                models[m]->reflectance({rgb.data() + 3 * begin, 3 * count}, formed);
                for (std::size_t i = 0; i < count; ++i) {
                    const auto r = formed.subspan(i * bands, bands);
                    const Vector3 clean = colorimetry.rgb_of(r);
                    std::copy(r.begin(), r.end(), spectrum.begin());
                    spectrum[bands] = 0;  // read with weight zero by a set of one band
                    const std::uint64_t pixel = static_cast<std::uint64_t>(y) * n + begin + i;
                    // The same random numbers for each method: they differ by their spectra alone.
                    const auto noisy = (*estimator)(spectrum.data(), mixed(mixed(options.seed) + pixel), options.samples_per_pixel);
                    for (std::size_t c = 0; c < 3; ++c) {
                        mine.clean[c][begin + i] = static_cast<float>(clean[c]);
                        mine.noisy[c][begin + i] = noisy[c];
                    }
                }
            }
            difference(pointers(mine.clean), pointers(mine.noisy), n, mine.noise.data());
            difference(pointers(row.truth), pointers(mine.clean), n, mine.distortion.data());
            display(mine.noisy, shown);
            shrinker.shrink(shown, 3, mine.shrunk);
            shrinker.shrink(mine.noise, 1, mine.shrunk_noise);
            shrinker.shrink(mine.distortion, 1, mine.shrunk_distortion);
        }
    };

    Panel truth(shrinker, 3);
    struct MethodPanels {
        Panel rendering, noise, distortion;
    };
    std::vector<MethodPanels> panels(models.size(), {Panel(shrinker, 3), Panel(shrinker, 1), Panel(shrinker, 1)});
    std::vector<Row> rows(static_cast<std::size_t>(std::min(lines_at_once, width)));
    for (auto& row : rows) {
        for (auto& plane_of : row.truth) plane_of.resize(n);
        row.methods.resize(models.size());
        for (auto& m : row.methods) {
            for (std::size_t c = 0; c < 3; ++c) m.clean[c].resize(n), m.noisy[c].resize(n);
            m.noise.resize(n), m.distortion.resize(n);
        }
    }
    tbb::task_arena arena(options.threads > 0 ? options.threads : tbb::task_arena::automatic);
    for (int first = 0; first < width; first += lines_at_once) {
        const int count = std::min(lines_at_once, width - first);
        arena.execute([&] { parallel_for(0, count, [&](int i) { render(rows[static_cast<std::size_t>(i)], first + i); }); });
        for (int i = 0; i < count; ++i) {
            const Row& row = rows[static_cast<std::size_t>(i)];
            const auto y = static_cast<std::size_t>(first + i);
            truth.add(y, row.shrunk);
            for (std::size_t m = 0; m < models.size(); ++m) {
                const MethodRow& mine = row.methods[m];
                panels[m].rendering.add(y, mine.shrunk);
                panels[m].noise.add(y, mine.shrunk_noise);
                panels[m].distortion.add(y, mine.shrunk_distortion);
                if (auto s = noise[m].add_row(first + i, mine.noise); !s) return s.error();
                if (auto s = distortion[m].add_row(first + i, mine.distortion); !s) return s.error();
            }
        }
        if (options.progress) options.progress(static_cast<std::uint64_t>(first + count) * n, out.texels);
    }
    out.truth = truth.result();
    for (std::size_t m = 0; m < models.size(); ++m) {
        out.methods[m].rendering = panels[m].rendering.result();
        out.methods[m].noise_map = panels[m].noise.result();
        out.methods[m].distortion_map = panels[m].distortion.result();
        auto a = noise[m].finish(), b = distortion[m].finish();
        if (!a) return std::move(a).error();
        if (!b) return std::move(b).error();
        out.methods[m].noise = *a, out.methods[m].distortion = *b;
    }
    return out;
}

}  // namespace spectex
