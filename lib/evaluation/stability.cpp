#include "evaluation/stability.h"

#include <fmt/format.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <mutex>

#include "parallel.h"
#include "spectex/color.h"
#include "spectex/methods.h"

namespace spectex::stability {
namespace {

constexpr std::uint64_t all_codes = 1u << 24;

/// 8-bit sRGB as the tools decode it.
double code_value(std::uint64_t code, bool single) {
    const double v = srgb_decode(static_cast<double>(code & 255) / 255);
    return single ? rounded(v) : v;
}

}  // namespace

void Tally::add(std::uint64_t i, double ulps) {
    ++cases;
    if (!(ulps >= 0)) {
        ++broken;
        broken_at = std::min(broken_at, i);
    } else if (ulps > worst || (ulps == worst && i < worst_at)) {
        worst = ulps, worst_at = i;
    }
}

void Tally::merge(const Tally& other) {
    cases += other.cases, broken += other.broken;
    broken_at = std::min(broken_at, other.broken_at);
    if (other.worst > worst || (other.worst == worst && other.worst_at < worst_at)) worst = other.worst, worst_at = other.worst_at;
    if (other.delta_e > delta_e || (other.delta_e == delta_e && other.delta_e_at < delta_e_at))
        delta_e = other.delta_e, delta_e_at = other.delta_e_at;
}

Tally measure(std::uint64_t count, std::uint64_t part, const std::function<void(std::uint64_t, std::uint64_t, Tally&)>& body) {
    Tally all;
    std::mutex mutex;
    parallel_for(std::uint64_t{0}, (count + part - 1) / part, [&](std::uint64_t p) {
        Tally mine;
        body(p * part, std::min(count, (p + 1) * part), mine);
        const std::lock_guard lock(mutex);
        all.merge(mine);
    });
    return all;
}

std::uint64_t scrambled(std::uint64_t x) {
    // Steele, Lea and Flood 2014, doi:10.1145/2714064.2660195.
    x += 0x9e3779b97f4a7c15;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9;
    x = (x ^ (x >> 27)) * 0x94d049bb133111eb;
    return x ^ (x >> 31);
}

std::vector<double> notable_values(bool single) {
    std::vector<double> out{0.0};
    const auto add = [&](double v) {
        if (single) {
            const auto f = static_cast<float>(v);
            for (const float n : {f, std::nextafter(f, -HUGE_VALF), std::nextafter(f, HUGE_VALF)}) out.push_back(static_cast<double>(n));
        } else {
            for (const double n : {v, std::nextafter(v, -HUGE_VAL), std::nextafter(v, HUGE_VAL)}) out.push_back(n);
        }
    };
    if (!single) add(5e-324), add(2.3e-308), add(1e-200), add(1e-100), add(1e-50);
    // Least float, least normal float, least half and normal half; what the last 8-bit code's half is; toes of sRGB, Lab.
    for (const double v : {1.4e-45, 1e-40, 1.17549435e-38, 1e-30, 1e-20, 1e-12, 1e-8, 0x1p-24, 0x1p-14, 0x1p-12, 1e-5, 0.5 / 255 / 12.92, 1 / 255.0 / 12.92,
                           0.0031308, 216.0 / 24389, 0.04045, 0.125, 0.25, 1.0 / 3, 0.5, 0.75, 0.875, 1.0})
        add(v);
    return out;
}

Colors::Colors(const StabilityOptions& options, Range range, bool single, std::uint64_t thinning)
    : stride_(options.stride * thinning), seed_(options.seed), range_(range), single_(single) {
    // Every triple of notable values: black, white, edges, faces, greys, walls of cells and of tetrahedra, and what lies a
    // unit in the last place from each.
    auto values = notable_values(single);
    if (range == Range::any) {
        for (const double v : {2.0, 65504.0, 65520.0, 1e10, 1e30}) values.push_back(v);
        for (const double v : {-1.4e-45, -1e-38, -1e-12, -0.0031308, -0.5, -1.0, -1e30}) values.push_back(single ? rounded(v) : v);
        for (const double v : {std::nan(""), HUGE_VAL, -HUGE_VAL}) values.push_back(v);
        if (single)
            for (double& v : values) v = rounded(v);
    } else {
        std::erase_if(values, [](double v) { return !(v >= 0 && v <= 1); });
    }
    std::vector<Vector3> all;
    // Greys and their neighbours, and the blue corner, whatever is thinned.
    const auto next = [&](double v, double to) {
        return single ? static_cast<double>(std::nextafter(static_cast<float>(v), static_cast<float>(to))) : std::nextafter(v, to);
    };
    for (int k = 0; k <= 64; ++k) {
        const double t = k / 64.0;
        for (const Vector3& v : {Vector3{t, t, t}, {t, t, next(t, 0.5)}, {t, next(t, 0.5), t}, {next(t, 0.5), t, t}}) all.push_back(v);
    }
    for (int k = 1; k <= 40; ++k)
        for (int m = 0; m < 4; ++m) {
            const double e = std::ldexp(1.0, -k);
            const double b = single ? rounded(1 - e) : 1 - e;
            all.push_back({m & 1 ? e : 0, m & 2 ? e : 0, b});
            all.push_back({m & 1 ? e : 0, m & 2 ? e : 0, 1});
        }
    const std::uint64_t n = values.size(), triples = n * n * n, step = std::max<std::uint64_t>(1, options.adversaries * thinning);
    for (std::uint64_t i = 0; i < triples; i += step) {
        // With a step, other triples each time round.
        const std::uint64_t at = step > 1 ? std::min(triples - 1, i + scrambled(i) % step) : i;
        all.push_back({values[at / (n * n)], values[at / n % n], values[at % n]});
    }
    fixed_ = std::move(all);
    random_ = options.colors / thinning;
    codes_ = (all_codes + stride_ - 1) / stride_;
}

Vector3 Colors::random(std::uint64_t i) const {
    std::uint64_t h = scrambled(seed_ * 0x2545f4914f6cdd1d + i);
    const auto next = [&] { return h = scrambled(h); };
    const auto kind = next() % (range_ == Range::any ? 10 : 8);
    Vector3 v{unit_of(next()), unit_of(next()), unit_of(next())};
    if (kind == 4) v[next() % 3] = static_cast<double>(next() & 1);
    if (kind == 5) {
        const auto axis = next() % 3;
        v[axis] = static_cast<double>(next() & 1), v[(axis + 1) % 3] = static_cast<double>(next() & 1);
    }
    if (kind == 6 || kind == 7) {
        // Dark, down to what an 8-bit code is far above, and its complement.
        const double scale = std::exp2(-40 * unit_of(next()));
        for (double& c : v) c = kind == 6 ? c * scale : 1 - c * scale;
    }
    if (kind >= 8)
        for (double& c : v) c = (next() & 1 ? -1 : 1) * std::pow(10.0, -38 + 68 * unit_of(next()));
    if (single_)
        for (double& c : v) c = rounded(c);
    return v;
}

Vector3 Colors::operator[](std::uint64_t i) const {
    if (i < fixed_.size()) return fixed_[i];
    i -= fixed_.size();
    if (i < random_) return random(i);
    const std::uint64_t code = (i - random_) * stride_;
    return {code_value(code >> 16, single_), code_value(code >> 8, single_), code_value(code, single_)};
}

std::string text_of(const Vector3& v) { return fmt::format("({:.9g}, {:.9g}, {:.9g})", v[0], v[1], v[2]); }

std::string Colors::describe(std::uint64_t i) const {
    if (i >= fixed_.size() + random_) {
        const std::uint64_t code = (i - fixed_.size() - random_) * stride_;
        return fmt::format("code {}, {}, {}", code >> 16, code >> 8 & 255, code & 255);
    }
    return text_of((*this)[i]);
}

StabilityRow& Study::add(std::string group, std::string path, std::string unit, const Tally& tally,
                         const std::function<std::string(std::uint64_t)>& describe, Bounds bounds) {
    StabilityRow row;
    row.group = std::move(group), row.path = std::move(path), row.unit = std::move(unit);
    row.cases = tally.cases;
    row.worst = std::max(tally.worst, 0.0);
    if (tally.worst_at != Tally::none && tally.worst > 0) row.worst_at = describe(tally.worst_at);
    if (tally.delta_e >= 0) row.delta_e = tally.delta_e;
    if (tally.delta_e_at != Tally::none && tally.delta_e > 0) row.delta_e_at = describe(tally.delta_e_at);
    row.broken = tally.broken;
    if (tally.broken > 0) row.broken_at = describe(tally.broken_at);
    row.most = bounds.most, row.most_delta_e = bounds.delta_e, row.reason = std::move(bounds.reason);
    report.rows.push_back(std::move(row));
    return report.rows.back();
}

StabilityRow& Study::figure(std::string group, std::string path, std::string unit, double value, std::string at, Bounds bounds) {
    Tally tally;
    tally.add(0, value);
    return add(std::move(group), std::move(path), std::move(unit), tally, [&](std::uint64_t) { return at; }, std::move(bounds));
}

}  // namespace spectex::stability

namespace spectex {

std::size_t StabilityReport::failures() const {
    return static_cast<std::size_t>(std::count_if(rows.begin(), rows.end(), [](const StabilityRow& r) { return !r.kept(); }));
}

const std::vector<std::string>& stability_groups() {
    static const std::vector<std::string> groups{"colours", "differences", "methods", "solvers", "lights", "sums", "conditioning"};
    return groups;
}

Result<StabilityReport> measure_stability(const Colorimetry& colorimetry, const StabilityOptions& options) {
    for (const auto& name : options.groups)
        if (std::find(stability_groups().begin(), stability_groups().end(), name) == stability_groups().end()) {
            std::string names;
            for (const auto& known : stability_groups()) names += (names.empty() ? "" : ", ") + known;
            return Error{ErrorKind::usage, fmt::format("stability group '{}' is not known: expected some of {}", name, names)};
        }
    for (const auto& id : options.methods)
        if (const auto known = find_method(id); !known) return known.error();
    StabilityOptions taken = options;
    taken.stride = std::max(1u, taken.stride), taken.adversaries = std::max(1u, taken.adversaries);
    if (taken.methods.empty())
        for (const auto& info : methods()) taken.methods.push_back(info.id);
    stability::Study study{colorimetry, taken, {}};
    const auto wanted = [&](std::string_view name) {
        return options.groups.empty() || std::find(options.groups.begin(), options.groups.end(), name) != options.groups.end();
    };
    Status status;
    tbb::task_arena arena(options.threads > 0 ? options.threads : tbb::task_arena::automatic);
    arena.execute([&] {
        if (wanted("colours")) stability::study_colors(study);
        if (wanted("differences")) stability::study_differences(study);
        if (wanted("methods")) status = stability::study_methods(study);
        if (status && wanted("solvers")) status = stability::study_solvers(study);
        if (status && wanted("lights")) status = stability::study_lights(study);
        if (status && wanted("sums")) status = stability::study_sums(study);
        if (status && wanted("conditioning")) status = stability::study_conditioning(study);
    });
    if (!status) return status.error();
    return std::move(study.report);
}

}  // namespace spectex
