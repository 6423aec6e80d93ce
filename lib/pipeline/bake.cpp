#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "color/baked_files.h"
#include "kernels/lattice.h"
#include "spectex/pipeline.h"

namespace spectex {
namespace {

/// OpenColorIO reads up to 129; a CLF of 65 takes 8 MB already.
constexpr std::size_t largest_grid = 65;
constexpr std::size_t largest_config = std::size_t{64} << 20;

/// The table of one image out of a table of several.
LatticeTable table_of(const LatticeTable& all, std::size_t image) {
    LatticeTable one;
    one.knots = all.knots;
    one.values = 3;
    for (std::size_t v = 0; v * all.values < all.vertices.size(); ++v)
        for (std::size_t c = 0; c < 3; ++c) one.vertices.push_back(all.vertices[v * all.values + 3 * image + c]);
    return one;
}

/// Whether the formats, whose grids are even and cubic, hold a table as it is.
bool is_even_cube(const LatticeTable& table) {
    const std::size_t n = table.knots[0].size();
    for (const auto& knots : table.knots) {
        if (knots.size() != n) return false;
        // Knots are computed or read back in one of several ways, each right to a rounding or two.
        for (std::size_t i = 0; i < n; ++i)
            if (std::abs(knots[i] - static_cast<double>(i) / static_cast<double>(n - 1)) > 0x1p-51) return false;
    }
    return n <= largest_grid;
}

std::vector<double> even_knots(std::size_t n) {
    std::vector<double> knots(n);
    for (std::size_t i = 0; i < n; ++i) knots[i] = static_cast<double>(i) / static_cast<double>(n - 1);
    return knots;
}

/// Colours in planes and what a plan makes of them.
struct Answers {
    std::array<std::vector<float>, 3> rgb;
    std::vector<std::vector<float>> lit;

    std::size_t size() const { return rgb[0].size(); }
    void add(float r, float g, float b) {
        rgb[0].push_back(r), rgb[1].push_back(g), rgb[2].push_back(b);
    }
    std::array<const float*, 3> colors() const { return {rgb[0].data(), rgb[1].data(), rgb[2].data()}; }
    std::array<const float*, 3> image(std::size_t k) const { return {lit[3 * k].data(), lit[3 * k + 1].data(), lit[3 * k + 2].data()}; }
    void answer(const RelightPlan& plan) {
        std::vector<float*> out;
        lit.assign(3 * plan.images(), std::vector<float>(size()));
        for (auto& plane : lit) out.push_back(plane.data());
        plan.execute_colors(colors(), size(), out);
    }
};

/// Colours of all kinds: everywhere, dark ones, and on the faces of the cube, where spectra bend most.
Answers test_colors() {
    Answers a;
    std::mt19937_64 random(20240607);
    const auto uniform = [&] { return static_cast<float>(static_cast<double>(random() >> 40) * 0x1p-24); };
    for (int i = 0; i < 12000; ++i) {
        float c[3] = {uniform(), uniform(), uniform()};
        if (i % 3 == 1)
            for (float& v : c) v = v * v * v;
        if (i % 3 == 2) c[random() % 3] = random() % 2 ? 1.0f : 0.0f;
        a.add(c[0], c[1], c[2]);
    }
    for (int i = 0; i <= 128; ++i) {
        const float v = static_cast<float>(i) / 128;
        a.add(v, v, v);
        for (int corner = 1; corner < 7; ++corner) a.add(corner & 1 ? v : 0, corner & 2 ? v : 0, corner & 4 ? v : 0);
    }
    return a;
}

/// What a table takes of each component. Dark colours, where CIELab is steep, need a finer grid than light ones.
enum class Shaper {
    none,
    root,     ///< its square root
    rooting,  ///< the same at color::shaper_entries even places, and linear in between
};
double shaped(Shaper shaper, double v) {
    if (shaper == Shaper::none) return v;
    if (shaper == Shaper::root) return std::sqrt(v);
    constexpr double last = color::shaper_entries - 1;
    const double i = std::min(std::floor(v * last), last - 1), low = std::sqrt(i / last);
    return low + (v * last - i) * (std::sqrt((i + 1) / last) - low);
}
double unshaped(Shaper shaper, double v) {
    if (shaper == Shaper::none) return v;
    if (shaper == Shaper::root) return v * v;
    constexpr double last = color::shaper_entries - 1;
    const double i = std::min(std::floor(v * v * last), last - 1), low = std::sqrt(i / last);
    return (i + (v - low) / (std::sqrt((i + 1) / last) - low)) / last;
}

/// A table of `n` vertices an axis, sampled from a plan. @param shaper  what stands before it.
LatticeTable sampled(const RelightPlan& plan, std::size_t n, Shaper shaper) {
    LatticeTable table;
    table.knots = {even_knots(n), even_knots(n), even_knots(n)};
    table.values = 3 * plan.images();
    table.vertices.resize(n * n * n * table.values);
    // A slab of red at a time bounds the planes.
    for (std::size_t r = 0; r < n; ++r) {
        Answers slab;
        const auto at = [&](std::size_t i) { return static_cast<float>(unshaped(shaper, table.knots[0][i])); };
        for (std::size_t g = 0; g < n; ++g)
            for (std::size_t b = 0; b < n; ++b) slab.add(at(r), at(g), at(b));
        slab.answer(plan);
        for (std::size_t p = 0; p < n * n; ++p)
            for (std::size_t j = 0; j < table.values; ++j) table.vertices[(r * n * n + p) * table.values + j] = slab.lit[j][p];
    }
    return table;
}

struct Errors {
    double mean = 0, max = 0;
};
/// CIE76 of a table against the truth, per image.
std::vector<Errors> errors_of(const LatticeTable& table, Shaper shaper, const Answers& truth, const Matrix3& to_xyz) {
    const std::size_t n = truth.size(), images = table.values / 3;
    Answers got;
    got.lit.assign(table.values, std::vector<float>(n));
    std::vector<float*> out;
    for (auto& plane : got.lit) out.push_back(plane.data());
    kernels::LatticeKernel kernel(table);
    auto taken = truth.rgb;
    for (auto& plane : taken)
        for (float& v : plane) v = static_cast<float>(shaped(shaper, static_cast<double>(v)));
    kernel({taken[0].data(), taken[1].data(), taken[2].data()}, n, out.data());
    std::vector<Errors> errors(images);
    std::vector<float> difference(n);
    for (std::size_t k = 0; k < images; ++k) {
        Vector3 white;
        for (std::size_t c = 0; c < 3; ++c) white[c] = table.vertices[table.vertices.size() - table.values + 3 * k + c];
        const DifferenceKernel compare(Metric::cie76, to_xyz, to_xyz, to_xyz * white);
        compare(truth.image(k), got.image(k), n, difference.data());
        double sum = 0;
        for (const float d : difference) {
            sum += d;
            errors[k].max = std::max(errors[k].max, static_cast<double>(d));
        }
        errors[k].mean = sum / static_cast<double>(n);
    }
    return errors;
}

double worst(const std::vector<Errors>& errors) {
    double max = 0;
    for (const auto& e : errors) max = std::max(max, e.max);
    return max;
}

std::string name_part(std::string_view name, bool of_file) {
    std::string out(name);
    for (char& c : out) {
        const bool letter = (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') ||
                            (static_cast<unsigned char>(c) & 0x80);
        const bool mark = c == '.' || c == '_' || c == '-' || c == '+';
        if (!letter && !mark && (of_file || c == ',' || c == ':' || c == '"' || c == '\\' || c == '$' || c == '%' || c == '/'))
            c = '_';
    }
    return out.empty() ? "_" : out;
}

Result<std::string> text_of(const std::string& path) {
    std::error_code failed;
    const auto size = std::filesystem::file_size(path, failed);
    if (failed) return Error{ErrorKind::input, fmt::format("{}: {}", path, failed.message())};
    if (size > largest_config) return Error{ErrorKind::input, fmt::format("{}: {} bytes: too large for an OCIO configuration", path, size)};
    std::string text(size, '\0');
    std::ifstream in(path, std::ios::binary);
    if (!in || !in.read(text.data(), static_cast<std::streamsize>(size)))
        return Error{ErrorKind::input, fmt::format("{}: cannot be read", path)};
    return text;
}

}  // namespace

Result<BakeReport> bake(const std::vector<std::string>& outputs, const RelightOptions& options, double max_error) {
    const std::size_t images = options.illuminants.size();
    if (images == 0) return Error{ErrorKind::usage, "no illuminant is given: expected one to bake, such as -i A"};
    if (outputs.empty()) return Error{ErrorKind::usage, "no file to bake to is given"};
    const auto suffix_of = [](const std::string& path) {
        std::string suffix = std::filesystem::path(path).extension().string();
        for (char& c : suffix)
            if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
        return suffix;
    };
    const std::string suffix = suffix_of(outputs[0]);
    if (suffix != ".cube" && suffix != ".clf" && suffix != ".spimtx" && suffix != ".ocio")
        return Error{ErrorKind::usage, fmt::format("{}: expected a name that ends in .cube, .clf, .spimtx or .ocio", outputs[0])};
    const bool config = suffix == ".ocio";
    if (outputs.size() != (config ? 1 : images))
        return Error{ErrorKind::usage, fmt::format("{} files to bake {} illuminants to: expected as many, or one .ocio", outputs.size(), images)};
    if (!options.output_colorspace.empty())
        return Error{ErrorKind::usage, "a baked transform gives linear RGB of its RGB space: expected no output colour space"};

    const auto colorimetry = Colorimetry::make(options.colorimetry, options.bands);
    if (!colorimetry) return colorimetry.error();
    const auto& space = colorimetry->rgb_space();
    const auto model = make_model(options.method, *colorimetry);
    if (!model) return model.error();
    RelightRequest request;
    request.illuminants = options.illuminants;
    request.adaptation = options.adaptation;
    request.normalization = options.normalization;
    request.observer = options.observer.value_or(colorimetry->observer().id);
    request.output_space = space.name;
    const auto plan = RelightPlan::for_model(*model, request);
    if (!plan) return plan.error();

    const bool linear = plan->matrix(0) != nullptr;
    if (suffix == ".spimtx" && !linear)
        return Error{ErrorKind::usage, fmt::format("{}: {} is not linear in RGB, so no matrix holds it: expected .clf, .cube or .ocio",
                                                   outputs[0], options.method)};
    LatticeTable table;
    std::vector<Errors> errors(images);
    bool exact = true;
    const bool sought = !linear && !(plan->table() && is_even_cube(*plan->table()));
    Shaper shaper = sought && suffix != ".cube" ? Shaper::root : Shaper::none;
    if (linear) {
        // A matrix on eight vertices, for the format that knows tables alone.
        if (suffix == ".cube") table = sampled(*plan, 2, Shaper::none);
    } else if (plan->table() && is_even_cube(*plan->table())) {
        table = *plan->table();
    } else {
        exact = false;
        Matrix3 to_xyz = colorimetry->rgb_to_xyz();
        Answers truth = test_colors();
        truth.answer(*plan);
        // Errors fall with the grid, if not at each step: the least grid is sought by halves, and the one that is taken was
        // itself measured.
        std::size_t low = 1, high = largest_grid;
        table = sampled(*plan, high, shaper);
        errors = errors_of(table, shaper, truth, to_xyz);
        if (suffix == ".cube" && worst(errors) > max_error) {
            // Not every reader of this format takes a one-dimensional table before the other, so it is there only at need.
            shaper = Shaper::rooting;
            table = sampled(*plan, high, shaper);
            errors = errors_of(table, shaper, truth, to_xyz);
        }
        if (worst(errors) > max_error)
            return Error{ErrorKind::input,
                         fmt::format("{} under these lights: a grid of {} vertices an axis is still off by CIE76 {:.3g}, expected at most "
                                     "{:g}: a larger --max-error, or a method that is linear in pieces, such as {}",
                                     options.method, high, worst(errors), max_error, default_method)};
        while (high - low > 1) {
            const std::size_t middle = (low + high) / 2;
            auto candidate = sampled(*plan, middle, shaper);
            auto measured = errors_of(candidate, shaper, truth, to_xyz);
            if (worst(measured) <= max_error) {
                high = middle;
                table = std::move(candidate);
                errors = std::move(measured);
            } else {
                low = middle;
            }
        }
    }

    BakeReport report;
    report.model = fmt::format("{}, {}", (*model)->info().id, colorimetry->describe());
    std::vector<std::string> texts;
    std::vector<color::Relight> relights;
    for (std::size_t k = 0; k < images; ++k) {
        const auto& light = options.illuminants[k];
        BakeReport::Output output;
        output.path = outputs[config ? 0 : k];
        output.illuminant = light.name;
        output.exact = exact;
        output.mean = errors[k].mean;
        output.max = errors[k].max;
        if (suffix_of(output.path) != suffix)
            return Error{ErrorKind::usage, fmt::format("{}: expected the suffix {} of the first output", output.path, suffix)};
        output.form = table.vertices.empty() ? "matrix" : "tetrahedral table";
        output.grid = table.vertices.empty() ? 0 : static_cast<int>(table.knots[0].size());

        const auto observer = find_observer(request.observer);
        color::Remarks remarks{fmt::format("spxrelight {}: {} under {} ({}), {}", version(), report.model, light.name, light.title,
                                           observer ? (*observer)->title : request.observer)};
        static constexpr const char* adaptations[] = {"none", "von Kries", "Bradford", "CAT02", "CAT16"};
        remarks.push_back(fmt::format("Adaptation {}; {}", adaptations[static_cast<std::size_t>(options.adaptation)],
                                      options.normalization == Normalization::luminance ? "a perfect diffuser has Y = 1"
                                                                                        : "the lamp's own power relative to D65"));
        remarks.push_back(fmt::format("Takes and gives linear {}{}", space.name, output.grid ? "; clamps what is outside [0,1]" : ""));
        if (output.grid && exact)
            remarks.push_back("Exact to float rounding with tetrahedral interpolation, and only so");
        else if (output.grid)
            remarks.push_back(fmt::format("Off from the method by CIE76 mean {:.3g} max {:.3g}, measured on {} colours with tetrahedral "
                                          "interpolation",
                                          output.mean, output.max, test_colors().size()));
        if (suffix == ".cube")
            remarks.push_back("This format cannot name its interpolation: set it to tetrahedral where the file is used "
                              "(OCIO: FileTransform interpolation=tetrahedral)");
        if (shaper == Shaper::rooting)
            remarks.push_back("A one-dimensional table of square roots stands first, as DaVinci Resolve and OpenColorIO read it; readers that "
                              "know only one table in a file need .clf, or a larger --max-error");
        const std::string name = fmt::format("{} under {}", (*model)->info().id, light.name);
        const auto one = table.vertices.empty() ? LatticeTable{} : table_of(table, k);
        if (suffix == ".cube")
            texts.push_back(color::cube_text(one, shaper == Shaper::rooting, remarks));
        else if (suffix == ".spimtx")
            texts.push_back(color::spimtx_text(*plan->matrix(k)));
        else
            texts.push_back(output.grid ? color::clf_text(one, shaper == Shaper::root, name, space, remarks)
                                        : color::clf_text(*plan->matrix(k), name, space, remarks));
        if (config) {
            std::string description = remarks[0];
            for (std::size_t i = 1; i < remarks.size(); ++i) description += ". " + remarks[i];
            relights.push_back({name_part(light.name, false),
                                fmt::format("{}_{}.clf", std::filesystem::path(output.path).stem().string(), name_part(light.name, true)),
                                texts.back(), description});
        }
        report.outputs.push_back(std::move(output));
    }
    if (!config) {
        for (std::size_t k = 0; k < images; ++k)
            if (auto s = write_text_file(outputs[k], texts[k]); !s) return s.error();
        return report;
    }
    std::string existing;
    std::error_code ignored;
    if (std::filesystem::exists(outputs[0], ignored)) {
        auto text = text_of(outputs[0]);
        if (!text) return text.error();
        if (text->empty()) return Error{ErrorKind::input, fmt::format("{}: is empty: expected an OCIO configuration", outputs[0])};
        existing = *std::move(text);
    }
    const auto written = color::config_text(existing, outputs[0], space, relights);
    if (!written) return written.error();
    // The tables first: a configuration never names a file that is not there.
    const auto folder = std::filesystem::path(outputs[0]).parent_path();
    for (const auto& relight : relights)
        if (auto s = write_text_file((folder / relight.file).string(), relight.clf); !s) return s.error();
    if (auto s = write_text_file(outputs[0], *written); !s) return s.error();
    return report;
}

}  // namespace spectex
