// What a run did, as one page for people.
#include <fmt/format.h>
#include <sys/stat.h>
#include <tbb/info.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <mutex>
#include <numeric>

#include "batch/manifest.h"
#include "batch/page.h"
#include "batch/small_png.h"
#include "batch/thumbnail_cache.h"
#include "io/internal.h"
#include "parallel.h"

namespace spectex {
namespace {

using namespace batch;

/// Pixels of a thumbnail's longer side, while there are few and when there are many.
constexpr int large_side = 96, small_side = 64;
constexpr std::size_t few_pictures = 300;
/// A thumbnail of a photograph in so many colours looks as in all of them, at a third of the bytes.
constexpr int thumbnail_colors = 96;
/// Of lists beside the table.
constexpr std::size_t most_failures = 1000, most_reasons = 12;

/// Any bytes as text of a page: in elements and in quoted attributes.
std::string html(std::string_view bytes) {
    std::string out;
    for (const char c : printable(bytes)) switch (c) {
            case '&': out += "&amp;"; break;
            case '<': out += "&lt;"; break;
            case '>': out += "&gt;"; break;
            case '"': out += "&quot;"; break;
            case '\'': out += "&#39;"; break;
            default: out += c;
        }
    return out;
}

std::string figure(double v) { return v == 0 ? "0" : fmt::format("{:.3g}", v); }

/// Whole numbers with thin spaces between thousands.
std::string grouped(std::uint64_t n) {
    std::string digits = fmt::format("{}", n);
    if (digits.size() > 4)
        for (std::size_t at = digits.size() - 3; at > 0 && at < digits.size(); at = at > 3 ? at - 3 : 0) digits.insert(at, "\u202f");
    return digits;
}

std::string_view status_text(const BatchFile& f) {
    return f.status == BatchStatus::skipped && f.use != "spectral" ? std::string_view("up to date") : batch_status_name(f.status);
}
bool has_pictures(const BatchFile& f) {
    return (f.status == BatchStatus::converted || f.status == BatchStatus::skipped) && f.measured && !f.output.empty();
}

/// Indices of the files that are shown, by path; and of these, those with pictures.
struct Choice {
    std::vector<std::size_t> rows, pictures;
};
Choice choose(const BatchReport& report, const BatchPageOptions& options) {
    const auto& files = report.files;
    const auto worse = [&](std::size_t a, std::size_t b) {
        const auto rank = [&](std::size_t i) { return std::pair(files[i].status != BatchStatus::failed, -(files[i].measured ? files[i].max : -1.0)); };
        return rank(a) != rank(b) ? rank(a) < rank(b) : a < b;
    };
    Choice choice;
    choice.rows.resize(files.size());
    std::iota(choice.rows.begin(), choice.rows.end(), std::size_t{0});
    if (choice.rows.size() > options.most_rows) {
        std::sort(choice.rows.begin(), choice.rows.end(), worse);
        choice.rows.resize(options.most_rows);
    }
    for (const std::size_t i : choice.rows)
        if (has_pictures(files[i])) choice.pictures.push_back(i);
    if (choice.pictures.size() > options.most_pictures) {
        std::sort(choice.pictures.begin(), choice.pictures.end(), worse);
        choice.pictures.resize(options.most_pictures);
    }
    std::sort(choice.rows.begin(), choice.rows.end());
    std::sort(choice.pictures.begin(), choice.pictures.end());
    return choice;
}

struct Pictures {
    std::optional<ThumbnailFiles> files;
    std::string failure;
};

/// Thumbnails of the chosen files, in their order.
std::vector<Pictures> make_pictures(const std::string& destination, const BatchReport& report, const Choice& choice, int side,
                                    const BatchPageOptions& options, BatchPageReport& done) {
    std::vector<Pictures> all(choice.pictures.size());
    struct stat s {};
    const bool kept = options.keep_thumbnails && ::stat(manifest_folder(destination).c_str(), &s) == 0;
    ThumbnailCache cache(kept ? manifest_folder(destination) + "/thumbnails.sqlite" : std::string());
    const std::string light = hash_text(fmt::format("{}", fmt::join(options.light.power.values(), " ")));
    std::vector<std::size_t> todo;
    std::uint64_t pixels = 0;
    const auto key = [&](const BatchFile& f) {
        return hash_text(fmt::format("{} {} {} {} {} {}", version(), f.content_hash, f.output_hash, light, side, thumbnail_colors));
    };
    for (std::size_t i = 0; i < all.size(); ++i) {
        const BatchFile& f = report.files[choice.pictures[i]];
        all[i].files = cache.find(f.relative, key(f));
        if (all[i].files) {
            ++done.from_cache;
            continue;
        }
        todo.push_back(i);
        pixels += static_cast<std::uint64_t>(f.width) * static_cast<std::uint64_t>(f.height);
    }
    std::atomic<std::uint64_t> passed{0};
    std::mutex mutex;
    const int threads = options.job.threads > 0 ? options.job.threads : tbb::info::default_concurrency();
    tbb::task_arena arena(threads);
    arena.execute([&] {
        parallel_for(std::size_t{0}, todo.size(), [&](std::size_t at) {
            // Else a thread that waits within one file would begin the next on top of it.
            tbb::this_task_arena::isolate([&] {
                const BatchFile& f = report.files[choice.pictures[todo[at]]];
                Pictures& p = all[todo[at]];
                ThumbnailOptions o;
                o.job.threads = 1;
                o.job.in_callers_arena = true;
                o.job.input_colorspace = options.job.input_colorspace;
                o.settings = options.settings;
                o.light = options.light;
                o.side = side;
                const auto made = thumbnails(f.input, f.output, o);
                if (made) {
                    ThumbnailFiles files;
                    files.width = made->source.width, files.height = made->source.height;
                    files.png = {small_png(made->source, thumbnail_colors), small_png(made->relit, thumbnail_colors),
                                 small_png(made->errors, thumbnail_colors)};
                    cache.keep(f.relative, key(f), files);
                    p.files = std::move(files);
                } else {
                    p.failure = made.error().message;
                }
                const auto sum = passed += static_cast<std::uint64_t>(f.width) * static_cast<std::uint64_t>(f.height);
                if (!options.job.progress) return;
                const std::lock_guard lock(mutex);
                options.job.progress(sum, pixels);
            });
        });
    });
    for (const auto& p : all) ++(p.files ? done.pictures : done.without);
    return all;
}

/// Bins of a quarter of a decade.
constexpr int bins_per_decade = 4;

/// How many files have an error within each bin, on a logarithmic axis; zeros and what is smaller stand in the first.
std::string histogram(const std::vector<double>& values, int low_decade, int high_decade, std::string_view name) {
    const int bins = (high_decade - low_decade) * bins_per_decade;
    std::vector<std::size_t> counts(static_cast<std::size_t>(bins));
    for (const double v : values) {
        const double at = v > 0 ? (std::log10(v) - low_decade) * bins_per_decade : 0;
        ++counts[static_cast<std::size_t>(std::clamp(static_cast<int>(std::floor(at)), 0, bins - 1))];
    }
    const std::size_t most = std::max<std::size_t>(1, *std::max_element(counts.begin(), counts.end()));
    constexpr double left = 8, top = 18, width = 384, height = 96;
    std::string svg = fmt::format("<svg viewBox=\"0 0 400 140\" role=\"img\" aria-label=\"{}: number of textures by error\">\n", name);
    for (int b = 0; b < bins; ++b) {
        const std::size_t n = counts[static_cast<std::size_t>(b)];
        if (n == 0) continue;
        const double x = left + width * b / bins, h = std::max(1.0, height * static_cast<double>(n) / static_cast<double>(most));
        const double from = std::pow(10, low_decade + static_cast<double>(b) / bins_per_decade),
                     to = std::pow(10, low_decade + static_cast<double>(b + 1) / bins_per_decade);
        svg += fmt::format("<g><title>{} to {}: {} textures</title><rect class=\"bar\" x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\"/>"
                           "<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">{}</text></g>\n",
                           b == 0 ? std::string("0") : figure(from), figure(to), n, x + 0.5, top + height - h, width / bins - 1, h,
                           x + width / bins / 2, top + height - h - 4, n);
    }
    svg += fmt::format("<line class=\"axis\" x1=\"{0}\" y1=\"{1}\" x2=\"{2}\" y2=\"{1}\"/>\n", left, top + height, left + width);
    for (int d = low_decade; d <= high_decade; ++d) {
        const double x = left + width * (d - low_decade) / (high_decade - low_decade);
        svg += fmt::format("<line class=\"axis\" x1=\"{0:.1f}\" y1=\"{1}\" x2=\"{0:.1f}\" y2=\"{2}\"/><text x=\"{0:.1f}\" y=\"{3}\" text-anchor=\"{4}\">{5}</text>\n", x,
                           top + height, top + height + 4, top + height + 17, d == low_decade ? "start" : d == high_decade ? "end" : "middle",
                           figure(std::pow(10, d)));
    }
    return svg + "</svg>";
}

std::string histograms(const BatchReport& report) {
    std::array<std::vector<double>, 3> values;
    for (const auto& f : report.files)
        if (f.measured) {
            values[0].push_back(f.mean);
            values[1].push_back(f.p99);
            values[2].push_back(f.max);
        }
    if (values[0].empty()) return "<p class=\"faint\">No output was measured.</p>\n";
    double low = 1e9, high = 0;
    for (const auto& list : values)
        for (const double v : list) {
            if (v > 0) low = std::min(low, v);
            high = std::max(high, v);
        }
    // Decades that hold every value; what is below a millionth is as good as none.
    const int high_decade = std::clamp(static_cast<int>(std::floor(std::log10(std::max(high, 1e-6)))) + 1, -5, 6);
    const int low_decade = std::clamp(static_cast<int>(std::floor(std::log10(std::min(low, std::max(high, 1e-6))))), -6, high_decade - 1);
    static constexpr const char* names[] = {"Mean ΔE", "99th percentile of ΔE", "Largest ΔE"};
    std::string out = "<div class=\"charts\">\n";
    for (std::size_t i = 0; i < 3; ++i)
        out += fmt::format("<figure><figcaption>{} of a texture</figcaption>\n{}</figure>\n", names[i], histogram(values[i], low_decade, high_decade, names[i]));
    return out + "</div>\n";
}

/// Legend of the thumbnails of errors.
Result<std::string> error_scale() {
    const auto map = find_color_map(default_color_map());
    if (!map) return map.error();
    const double span = std::log10(thumbnail_error_high / thumbnail_error_low);
    std::string svg = "<figure class=\"scale\"><figcaption>Colours of the pictures of ΔE: the largest within each pixel, on a logarithmic scale</figcaption>\n"
                      "<svg viewBox=\"0 0 400 38\" role=\"img\" aria-label=\"Scale of ΔE from 0.001 to 10\">\n<defs><linearGradient id=\"scale\">";
    constexpr int stops = 16;
    for (int i = 0; i <= stops; ++i) {
        const Rgb8 c = map->at(static_cast<double>(i) / stops);
        svg += fmt::format("<stop offset=\"{:.4f}\" stop-color=\"#{:02x}{:02x}{:02x}\"/>", static_cast<double>(i) / stops, c[0], c[1], c[2]);
    }
    svg += "</linearGradient></defs>\n<rect x=\"8\" y=\"2\" width=\"384\" height=\"14\" fill=\"url(#scale)\" stroke=\"#888\" stroke-width=\".5\"/>\n";
    for (int d = 0; d <= static_cast<int>(std::lround(span)); ++d)
        svg += fmt::format("<text x=\"{:.1f}\" y=\"32\" text-anchor=\"{}\">{}{}</text>\n", 8 + 384 * d / span,
                           d == 0 ? "start" : d == std::lround(span) ? "end" : "middle", d == 0 ? "≤ " : d == std::lround(span) ? "≥ " : "",
                           figure(thumbnail_error_low * std::pow(10, d)));
    return svg + "</svg></figure>\n";
}

/// What was left alone, by what it is, with the commonest reasons.
std::string reasons(const BatchReport& report) {
    struct Kind {
        std::size_t files = 0;
        std::map<std::string, std::size_t> reasons;
    };
    std::map<std::string, Kind> kinds;
    for (const auto& f : report.files) {
        if (f.status != BatchStatus::data && f.status != BatchStatus::skipped) continue;
        Kind& kind = kinds[f.status == BatchStatus::data ? "Data, " + (f.use == "data" ? "other" : f.use) : f.use == "spectral" ? "Spectra already" : "Up to date"];
        ++kind.files;
        ++kind.reasons[f.reason];
    }
    std::string out = "<div class=\"reasons\">\n";
    for (const auto& [name, kind] : kinds) {
        std::vector<std::pair<std::size_t, std::string>> list;
        for (const auto& [reason, n] : kind.reasons) list.emplace_back(n, reason);
        std::stable_sort(list.begin(), list.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
        out += fmt::format("<div><h3>{}: {} {}</h3><ul>", html(name), grouped(kind.files), kind.files == 1 ? "file" : "files");
        for (std::size_t i = 0; i < std::min(list.size(), most_reasons); ++i)
            out += fmt::format("<li>{}{}</li>", list[i].first > 1 ? grouped(list[i].first) + " × " : std::string(), html(list[i].second));
        if (list.size() > most_reasons) out += fmt::format("<li class=\"faint\">and {} other reasons: see the table</li>", list.size() - most_reasons);
        out += "</ul></div>\n";
    }
    const auto count = [&](std::size_t n, std::string_view name, std::string_view why) {
        if (n > 0) out += fmt::format("<div><h3>{}: {} {}</h3><ul><li>{}</li></ul></div>\n", name, grouped(n), n == 1 ? "file" : "files", why);
    };
    count(report.excluded, "Excluded", "by --include, --exclude or --scene; not in the table");
    count(report.other_shards, "Other shards", "other tasks of the job array convert them; not in the table");
    count(report.not_images, "Not images", "no image reader claims their suffix; not in the table");
    return out + "</div>\n";
}

std::string total(std::string_view name, const std::string& value, std::string_view style = {}) {
    return fmt::format("<div><dt>{}</dt><dd{}>{}</dd></div>\n", name, style.empty() ? std::string() : fmt::format(" class=\"{}\"", style), value);
}

std::string number_cell(std::string_view label, bool known, double value, const std::string& text) {
    if (!known) return fmt::format("<td class=\"n\" data-l=\"{}\">–</td>", label);
    return fmt::format("<td class=\"n\" data-l=\"{}\" data-v=\"{}\">{}</td>", label, value, text);
}

std::string image(const std::vector<std::uint8_t>& png, int width, int height, int side, std::string_view what, bool crisp) {
    return fmt::format("<img loading=\"lazy\" decoding=\"async\" width=\"{0}\" height=\"{0}\"{1} alt=\"{2}\" src=\"data:image/png;base64,{3}\">", side,
                       crisp && std::max(width, height) < side ? " class=\"px\"" : "", what, base64(png));
}

/// A path that may be broken after folders and between words.
std::string breakable(std::string_view path) {
    std::string out;
    std::size_t begin = 0;
    for (std::size_t i = 0; i < path.size(); ++i)
        if (path[i] == '/' || path[i] == '_' || path[i] == '-') {
            out += html(path.substr(begin, i + 1 - begin)) + "<wbr>";
            begin = i + 1;
        }
    return out + html(path.substr(begin));
}

std::string row(const BatchFile& f, const Pictures* pictures, int side, const std::string& light) {
    std::string out = fmt::format("<tr data-s=\"{}\"><th scope=\"row\">{}<small>{}</small></th>", batch_status_name(f.status), breakable(f.relative), html(f.reason));
    out += "<td class=\"pictures\">";
    if (pictures && pictures->files) {
        const auto& p = *pictures->files;
        out += image(p.png[0], p.width, p.height, side, "source", true) + image(p.png[1], p.width, p.height, side, "under " + html(light), true) +
               image(p.png[2], p.width, p.height, side, "errors", true);
    } else if (pictures) {
        out += fmt::format("<small style=\"white-space:normal;line-height:1.3\">no pictures: {}</small>", html(pictures->failure));
    }
    out += "</td>";
    out += fmt::format("<td data-l=\"Use\">{}</td><td class=\"s {}\" data-l=\"Status\">{}</td>", html(f.use.empty() ? "–" : f.use), batch_status_name(f.status),
                       status_text(f));
    const bool sized = f.width > 0 && f.height > 0;
    out += number_cell("Size", sized, static_cast<double>(f.width) * f.height, fmt::format("{} × {}", f.width, f.height));
    out += number_cell("ΔE mean", f.measured, f.mean, figure(f.mean)) + number_cell("ΔE p99", f.measured, f.p99, figure(f.p99)) +
           number_cell("ΔE max", f.measured, f.max, figure(f.max));
    out += number_cell("Codes changed", f.measured, static_cast<double>(f.changed_codes), grouped(f.changed_codes)) +
           number_cell("Out of gamut", f.measured, static_cast<double>(f.out_of_gamut), grouped(f.out_of_gamut)) +
           number_cell("Not finite", f.measured, static_cast<double>(f.nonfinite), grouped(f.nonfinite));
    return out + "</tr>\n";
}

Result<std::string> page(const std::string& source, const std::string& destination, const BatchReport& report, const Choice& choice,
                         const std::vector<Pictures>& pictures, int side, const BatchPageOptions& options) {
    std::string out = "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
                      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
                      // Whatever a name might smuggle in, the page loads nothing.
                      "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n"
                      // Else browsers ask the server for an icon.
                      "<link rel=\"icon\" href=\"data:,\">\n";
    out += fmt::format("<title>spxbatch: {} to {}</title>\n<style>\n{}</style>\n</head>\n<body>\n", html(source), html(destination), page_style);
    out += fmt::format("<header>\n<h1>Texture library</h1>\n<p class=\"path\">{} <span class=\"faint\">to</span> {}</p>\n<dl class=\"totals\">\n", html(source), html(destination));
    std::size_t current = 0, measured = 0;
    const BatchFile* worst = nullptr;
    for (const auto& f : report.files) {
        current += f.status == BatchStatus::skipped && f.use != "spectral";
        if (!f.measured) continue;
        ++measured;
        if (!worst || f.max > worst->max) worst = &f;
    }
    out += total("Files", grouped(report.files.size())) + total("Converted", grouped(report.converted), "converted") +
           total("Up to date", grouped(current)) + total("Data maps", grouped(report.data)) +
           (report.skipped > current ? total("Spectra already", grouped(report.skipped - current)) : std::string()) +
           total("Failed", grouped(report.failed), report.failed > 0 ? "failed" : "") +
           total("Mpixel computed", fmt::format("{:.1f}", static_cast<double>(report.pixels) / 1e6)) +
           (worst ? total("Largest ΔE", figure(worst->max)) : std::string());
    out += "</dl>\n</header>\n<main>\n";

    if (report.failed > 0) {
        out += fmt::format("<section class=\"failures\" id=\"failures\">\n<h2>{} failed</h2>\n<ul>\n", grouped(report.failed));
        std::size_t listed = 0;
        for (const auto& f : report.files)
            if (f.status == BatchStatus::failed && listed++ < most_failures) {
                const std::string own = f.input + ": ";
                const std::string_view reason = f.reason;
                out += fmt::format("<li><b>{}</b>: {}</li>\n", html(f.relative), html(reason.starts_with(own) ? reason.substr(own.size()) : reason));
            }
        if (listed > most_failures) out += fmt::format("<li>and {} more: the JSON report has them all</li>\n", listed - most_failures);
        out += "</ul>\n</section>\n";
    }

    out += "<section>\n<h2>Errors</h2>\n";
    out += fmt::format("<p>CIE76 ΔE of each texture's round trip through its stored file, of {} textures.", grouped(measured));
    if (worst) out += fmt::format(" The largest is {} in <span class=\"path\">{}</span>.", figure(worst->max), html(worst->relative));
    out += "</p>\n" + histograms(report);
    if (!choice.pictures.empty()) {
        auto scale = error_scale();
        if (!scale) return std::move(scale).error();
        out += *scale;
    }
    out += "</section>\n<section>\n<h2>What was left alone, and why</h2>\n" + reasons(report) + "</section>\n";

    out += "<section>\n<h2>Settings</h2>\n<dl class=\"facts\">\n";
    for (const auto& [name, value] : options.facts) out += fmt::format("<dt>{}</dt><dd>{}</dd>\n", html(name), html(value));
    out += "</dl>\n</section>\n<section class=\"files\">\n<h2>Files</h2>\n"
           "<div class=\"controls\"><label>Show <select id=\"status\"><option value=\"\">all</option>";
    for (const auto status : {BatchStatus::converted, BatchStatus::skipped, BatchStatus::data, BatchStatus::failed})
        out += fmt::format("<option value=\"{0}\">{0}</option>", batch_status_name(status));
    out += "</select></label><label>Name, reason or use holds <input id=\"search\" type=\"search\" autocomplete=\"off\" spellcheck=\"false\"></label>"
           "<output id=\"shown\" role=\"status\" for=\"status search\"></output></div>\n";
    std::string caption = fmt::format("Pictures: the source, the output lit by {} without adaptation to it, and ΔE.", html(options.light.name));
    if (choice.rows.size() < report.files.size())
        caption += fmt::format(" The table has {} of {} files, failures and the largest errors first; the JSON report has all.", grouped(choice.rows.size()), grouped(report.files.size()));
    const auto candidates = static_cast<std::size_t>(std::count_if(report.files.begin(), report.files.end(), has_pictures));
    if (choice.pictures.size() < candidates)
        caption += fmt::format(" The {} textures of the largest errors out of {} have pictures.", grouped(choice.pictures.size()), grouped(candidates));
    out += fmt::format("<table id=\"files\">\n<caption>{}</caption>\n<thead><tr>", caption);
    out += "<th scope=\"col\" aria-sort=\"ascending\" data-t=\"Texture\"><button type=\"button\">Texture</button></th><th scope=\"col\" class=\"plain\"><span class=\"head\" style=\"display:block\">Pictures</span></th>"
           "<th scope=\"col\" data-t=\"Use\"><button type=\"button\">Use</button></th><th scope=\"col\" data-t=\"Status\"><button type=\"button\">Status</button></th>";
    for (const auto name : {"Size", "ΔE mean", "ΔE p99", "ΔE max", "Codes changed", "Out of gamut", "Not finite"})
        out += fmt::format("<th scope=\"col\" class=\"n\" data-t=\"{0}\"><button type=\"button\">{0}</button></th>", name);
    out += "</tr></thead>\n<tbody>\n";
    std::size_t next = 0;
    for (const std::size_t i : choice.rows) {
        const bool shown = next < choice.pictures.size() && choice.pictures[next] == i;
        out += row(report.files[i], shown ? &pictures[next] : nullptr, side, options.light.name);
        next += shown;
    }
    out += fmt::format("</tbody>\n</table>\n</section>\n<footer>Codes changed: 8-bit sRGB codes that differ after the round trip, among the pixels that were measured. Out of gamut, not "
                       "finite: pixels that were brought into range. spxbatch {}</footer>\n</main>\n<script>\n{}</script>\n</body>\n</html>\n",
                       version(), page_script);
    return out;
}

}  // namespace

Result<BatchPageReport> write_batch_page(const std::string& path, const std::string& source, const std::string& destination,
                                         const BatchReport& report, const BatchPageOptions& options) {
    return io::guarded(ErrorKind::output, path, [&]() -> Result<BatchPageReport> {
        BatchPageReport done;
        const Choice choice = choose(report, options);
        const int side = choice.pictures.size() > few_pictures ? small_side : large_side;
        const auto pictures = make_pictures(destination, report, choice, side, options, done);
        const auto text = page(source, destination, report, choice, pictures, side, options);
        if (!text) return text.error();
        if (auto s = write_text_file(path, *text); !s) return s.error();
        done.rows = choice.rows.size();
        done.bytes = text->size();
        return done;
    });
}

}  // namespace spectex
