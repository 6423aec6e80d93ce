#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <tbb/info.h>
#include <tbb/task_arena.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <charconv>
#include <chrono>
#include <filesystem>
#include <map>
#include <mutex>
#include <set>
#include <unordered_map>

#include "batch/discover.h"
#include "batch/manifest.h"
#include "io/internal.h"
#include "parallel.h"

namespace spectex {
namespace {

using namespace batch;
namespace fs = std::filesystem;

/// Strips in flight, as the pipeline bounds them, and what a file takes beside them.
constexpr std::uint64_t strips_bytes = std::uint64_t{3} * (std::uint64_t{24} << 20), file_bytes = std::uint64_t{16} << 20;

enum class Action { none, convert, copy_data };

struct Item {
    BatchFile file;
    Row row;                    ///< as it will be noted
    std::optional<Row> before;  ///< as the manifest has it
    Action action = Action::none;
    bool other_shard = false, changed_row = false;
    std::uint64_t pixels = 0, memory = 0;
    const Row* donor = nullptr;      ///< has the output of this content already
    std::vector<Item*> followers;    ///< of the same content: copied once this one is made
    std::atomic<std::uint64_t> done{0};
};

std::string absolute(const std::string& path) {
    std::error_code error;
    const auto real = fs::canonical(path, error);
    return error ? std::string() : real.string();
}

Status check_folders(const std::string& source, const std::string& destination, bool create) {
    struct stat s {};
    if (::stat(source.c_str(), &s) != 0 || !S_ISDIR(s.st_mode))
        return Error{ErrorKind::usage, fmt::format("{}: expected a folder of textures", source)};
    if (::stat(destination.c_str(), &s) != 0) {
        const auto parent = fs::path(destination).lexically_normal();
        const auto above = (parent.has_filename() ? parent : parent.parent_path()).parent_path();
        if (!above.empty() && (::stat(above.c_str(), &s) != 0 || !S_ISDIR(s.st_mode)))
            return Error{ErrorKind::usage, fmt::format("{}: there is no folder '{}'", destination, above.string())};
        if (create && ::mkdir(destination.c_str(), 0777) != 0 && errno != EEXIST)
            return Error{ErrorKind::output, fmt::format("{}: {}", destination, io::errno_text(errno))};
        return {};
    }
    if (!S_ISDIR(s.st_mode)) return Error{ErrorKind::usage, fmt::format("{}: is a file: expected a folder for the outputs", destination)};
    const std::string from = absolute(source), to = absolute(destination);
    if (from == to || to == "/" || from.starts_with(to + "/"))
        return Error{ErrorKind::usage, fmt::format("{}: holds the source {}: expected a folder of its own", destination, source)};
    return {};
}

Status make_folders(const std::string& folder) {
    std::error_code error;
    fs::create_directories(folder, error);
    if (error) return Error{ErrorKind::output, fmt::format("{}: {}", folder, error.message())};
    return {};
}

/// A file's bytes under another name, complete or not at all.
Status copy_file(const std::string& from, const std::string& to) {
    if (auto s = make_folders(fs::path(to).parent_path().string()); !s) return s;
    auto copied = copy_output(from, to);
    return copied ? Status() : Status(Error{ErrorKind::output, copied.error().message});
}

class Run {
public:
    Run(const std::string& source, const std::string& destination, const BatchOptions& options)
        : source_(source), destination_(destination), options_(options),
          threads_(options.job.threads > 0 ? options.job.threads : tbb::info::default_concurrency()), arena_(threads_) {}

    Result<BatchReport> run() {
        if (auto s = check_folders(source_, destination_, !options_.dry_run); !s) return s.error();
        std::vector<Lock> locks;
        if (!options_.dry_run) {
            if (auto s = make_folders(manifest_folder(destination_)); !s) return s.error();
            auto taken = lock_destination(destination_, options_.shard);
            if (!taken) return std::move(taken).error();
            locks = *std::move(taken);
        }
        if (auto s = open_manifest(); !s) return s.error();
        auto model = solve_model(options_.settings);
        if (!model) return std::move(model).error();
        model_ = *std::move(model);
        report_.model = fmt::format("{}, {}", model_->info().id, model_->colorimetry().describe());
        settings_text_ = fmt::format("{}\n{}\n{}\n{}\n{}\n{}\n{}", version(), hash_text(model_->to_json()),
                                     static_cast<int>(options_.settings.store), static_cast<int>(options_.layout),
                                     options_.compression.empty() ? "zip" : options_.compression, options_.check_all,
                                     options_.job.input_colorspace);
        const auto& set = options_.settings;
        settings_text_ += fmt::format("\n{}\n{}\n{}", set.max_error.value_or(-1), set.choose_bands, set.least_bands);
        // Appended where it is on, so that manifests from before it keep their meaning.
        if (set.skip_transparent) settings_text_ += "\nskip transparent";
        for (const auto& light : set.lights)
            settings_text_ += fmt::format("\n{} {}", light.name, hash_text(fmt::format("{}", fmt::join(light.power.values(), " "))));

        list();
        arena_.execute([&] {
            parallel_for(std::size_t{0}, items_.size(), [&](std::size_t i) {
                // Else a thread that waits within one file would begin the next on top of it.
                tbb::this_task_arena::isolate([&] { decide(*items_[i]); });
            });
        });
        pair_up();
        if (!options_.dry_run) {
            if (auto s = remove_leftovers(); !s) return s.error();
        }
        work();
        if (auto s = finish(); !s) return s.error();
        return std::move(report_);
    }

private:
    Status open_manifest() {
        auto manifest = Manifest::open(manifest_path(destination_, options_.shard), !options_.dry_run);
        if (!manifest) return manifest.error();
        manifest_ = std::make_unique<Manifest>(*std::move(manifest));
        auto rows = manifest_->rows();
        if (!rows) return rows.error();
        rows_ = *std::move(rows);
        if (!options_.shard || !rows_.empty()) return {};
        // A shard that begins knows what an earlier run of the whole has left.
        auto whole = Manifest::open(manifest_path(destination_, std::nullopt), false);
        if (!whole) return whole.error();
        rows = whole->rows();
        if (!rows) return rows.error();
        rows_ = *std::move(rows);
        seeded_ = true;
        return {};
    }

    void list() {
        auto found = discover(source_, destination_);
        report_.not_images = found.not_images;
        for (std::size_t i = 0; i < found.errors.size(); ++i) {
            BatchFile file;
            file.input = source_ + "/" + found.error_paths[i];
            file.relative = found.error_paths[i];
            file.status = BatchStatus::failed;
            file.reason = found.errors[i].message;
            broken_.push_back(std::move(file));
        }
        const auto names = output_names(found.images);
        std::set<std::string> only;
        if (options_.only)
            for (const auto& path : *options_.only) only.insert(absolute(path));
        for (std::size_t i = 0; i < found.images.size(); ++i) {
            const auto& path = found.images[i];
            const auto hit = [&](const std::string& pattern) { return matches(pattern, path); };
            const bool in = options_.include.empty() || std::any_of(options_.include.begin(), options_.include.end(), hit);
            outputs_.insert(names[i]);
            if (!in || (options_.only && !only.contains(absolute(source_ + "/" + path))) || std::any_of(options_.exclude.begin(), options_.exclude.end(), hit)) {
                ++report_.excluded;
                continue;
            }
            auto item = std::make_unique<Item>();
            item->file.relative = path;
            item->file.input = source_ + "/" + path;
            item->row.path = path;
            item->row.output = names[i];
            if (const auto row = rows_.find(path); row != rows_.end()) item->before = row->second;
            items_.push_back(std::move(item));
        }
    }

    std::string settings_hash(PixelType input) const {
        const auto type = options_.settings.type.value_or(default_stored_type(input));
        return hash_text(fmt::format("{}\n{}", settings_text_, pixel_type_name(type)));
    }
    /// The gamut's policy matters only where it was needed, and strictness only where it would refuse.
    bool same_mapping(const Row& row) const {
        return (row.out_of_gamut == 0 || row.gamut == static_cast<int>(options_.settings.gamut)) &&
               !(options_.job.strict && row.nonfinite > 0);
    }
    std::string in_destination(const std::string& relative) const { return destination_ + "/" + relative; }

    static void fail(Item& item, const std::string& reason) {
        item.file.status = BatchStatus::failed;
        item.file.reason = reason.find(item.file.input) == std::string::npos ? item.file.input + ": " + reason : reason;
        item.action = Action::none;
        item.row.output.clear();
        item.row.output_hash.clear();
        item.changed_row = true;
    }

    /// What is to be done with one file, and why.
    void decide(Item& item) {
        Row& row = item.row;
        const auto stamp = stamp_of(item.file.input);
        if (!stamp) return fail(item, "cannot be read: missing, a dangling link, or no regular file");
        row.stamp = *stamp;
        const auto& before = item.before;
        const bool untouched = before && before->stamp == *stamp && !before->content.empty();
        if (untouched) {
            row.content = before->content;
        } else {
            auto hash = hash_file(item.file.input);
            if (!hash) return fail(item, hash.error().message);
            row.content = *std::move(hash);
            item.changed_row = true;
        }
        item.file.content_hash = row.content;
        const bool same_content = before && before->content == row.content;
        if (options_.shard && shard_of(row.content, options_.shard->count) != options_.shard->index) {
            item.other_shard = true;
            if (same_content) {
                const auto kept = row.stamp;
                row = *before;
                row.stamp = kept;
            } else {
                row.status = "other shard";
                row.output.clear();
            }
            return;
        }
        if (!judge(item, same_content)) return;
        item.file.use = row.use;
        const bool color = row.use != "spectral" && is_color(*parse_texture_use(row.use));
        if (!color) return decide_data(item, same_content);

        const bool known = same_content && before->status == "converted";
        if (known) row.input_type = before->input_type, row.width = before->width, row.height = before->height;
        if (known) row.settings = settings_hash(static_cast<PixelType>(row.input_type));
        const bool current = known && before->settings == row.settings && same_mapping(*before);
        item.file.output = in_destination(row.output);
        if (current && before->output == row.output && output_whole(*before)) {
            const auto stamp_now = row.stamp;
            row = *before;
            row.stamp = stamp_now;
            item.file.status = BatchStatus::skipped;
            item.file.reason = "up to date";
            item.file.width = row.width, item.file.height = row.height;
            return;
        }
        item.file.status = BatchStatus::converted;
        item.file.reason = fmt::format("{}: {}", !before || before->status == "other shard" ? "new"
                                                 : !same_content                            ? "its content changed"
                                                 : before->status == "failed"               ? "it failed before"
                                                 : before->status == "damaged"              ? "its output was damaged"
                                                 : before->status == "data"                 ? "it was taken for data before"
                                                 : !current                                 ? "settings changed"
                                                 : before->output != row.output             ? "its output has another name now"
                                                                                            : "its output is gone or was changed",
                                       row.use_reason);
        auto reader = ImageReader::open(item.file.input, 1);
        if (!reader) return fail(item, reader.error().message);
        const auto& header = (*reader)->header();
        row.input_type = static_cast<int>(header.type);
        row.width = header.geometry.width, row.height = header.geometry.height;
        row.settings = settings_hash(header.type);
        row.gamut = static_cast<int>(options_.settings.gamut);
        item.pixels = static_cast<std::uint64_t>(row.width) * static_cast<std::uint64_t>(row.height);
        const std::uint64_t raw = pixel_bytes(header.type) * header.channels.size();
        const std::uint64_t stored = 4 * (options_.settings.store == Store::spectral ? model_->colorimetry().bands().size() + 3 : 6);
        const std::uint64_t rows16 = 16 * static_cast<std::uint64_t>(row.width) * (raw + stored);
        // A decoder that cannot stream holds the whole image; the differences of one row in 16 are kept for percentiles.
        item.memory = file_bytes + item.pixels * raw + std::min(item.pixels * (raw + stored), std::max(strips_bytes, 3 * rows16)) +
                      std::min<std::uint64_t>(item.pixels / (options_.check_all ? 1 : 16) * 4, std::uint64_t{1} << 28);
        item.action = Action::convert;
        item.changed_row = true;
    }

    /// Colour or data: by a rule, by the manifest, or by looking. False when the item is settled.
    bool judge(Item& item, bool same_content) {
        Row& row = item.row;
        TextureUseOptions look;
        look.root = source_;
        look.treat_as = options_.treat_as;
        if (!look.treat_as.empty()) {
            if (const auto verdict = judge_texture(item.file.input, nullptr, nullptr, look); verdict.by_option) {
                row.use = texture_use_name(verdict.use);
                row.use_reason = verdict.reason;
                row.use_by_option = true;
                row.classifier = version();
                item.changed_row = item.changed_row || !item.before || item.before->use != row.use || !item.before->use_by_option;
                return true;
            }
        }
        if (options_.only) {
            row.use = texture_use_name(TextureUse::color);
            row.use_reason = "colour: the scene uses it as a reflectance";
            row.use_by_option = true;
            row.classifier = version();
            item.changed_row = item.changed_row || !item.before || item.before->use != row.use || !item.before->use_by_option;
            return true;
        }
        if (same_content && !item.before->use_by_option && item.before->classifier == version() &&
            (item.before->use == "spectral" || parse_texture_use(item.before->use))) {
            row.use = item.before->use;
            row.use_reason = item.before->use_reason;
            row.classifier = item.before->classifier;
            return true;
        }
        item.changed_row = true;
        row.classifier = version();
        const auto kind = probe(item.file.input);
        if (!kind) {
            fail(item, kind.error().message);
            return false;
        }
        if (*kind != FileKind::image) {
            row.use = "spectral";
            row.use_reason = *kind == FileKind::spectral ? "it holds spectra already" : "it holds coefficients already";
            return true;
        }
        auto verdict = classify_texture(item.file.input, look);
        if (!verdict) {
            fail(item, verdict.error().message);
            return false;
        }
        row.use = texture_use_name(verdict->use);
        row.use_reason = verdict->reason;
        return true;
    }

    void decide_data(Item& item, bool same_content) {
        Row& row = item.row;
        const auto& before = item.before;
        const bool spectral = row.use == "spectral";
        item.file.status = spectral ? BatchStatus::skipped : BatchStatus::data;
        item.file.reason = row.use_reason;
        row.output.clear();
        if (spectral || options_.data == DataMaps::skip) {
            item.changed_row = item.changed_row || !before || before->status != batch_status_name(item.file.status) || !before->output.empty();
            return;
        }
        row.output = row.path;
        item.file.output = in_destination(row.output);
        if (same_content && before->status == "data" && before->output == row.output && output_whole(*before)) {
            row.output_hash = before->output_hash;
            row.output_stamp = before->output_stamp;
            return;
        }
        item.action = Action::copy_data;
        item.changed_row = true;
    }

    /// By its stamp; where that differs, by its bytes.
    bool output_whole(const Row& row) const {
        if (row.output.empty() || row.output_hash.empty() || !stays_below(row.output)) return false;
        const auto stamp = stamp_of(in_destination(row.output));
        if (!stamp) return false;
        if (*stamp == row.output_stamp) return true;
        const auto hash = hash_file(in_destination(row.output));
        return hash && *hash == row.output_hash;
    }

    /// Finds for each conversion an output of the same content: of the manifest, or of this run.
    void pair_up() {
        const auto key = [](const Row& row) { return row.content + row.settings + io::suffix_of(row.path); };
        std::map<std::string, const Row*> donors;
        for (const auto& [path, row] : rows_)
            if (row.status == "converted" && same_mapping(row)) donors.emplace(key(row), &row);
        std::map<std::string, Item*> leaders;
        for (auto& item : items_) {
            if (item->action != Action::convert) continue;
            if (const auto donor = donors.find(key(item->row)); donor != donors.end() && output_whole(*donor->second)) {
                item->donor = donor->second;
                item->file.reason = fmt::format("copied from {}, of the same content", donor->second->output);
                continue;
            }
            const auto [leader, first] = leaders.emplace(key(item->row), item.get());
            if (first) continue;
            leader->second->followers.push_back(item.get());
            item->file.reason = fmt::format("copied from {}, of the same content", leader->second->row.output);
        }
    }

    /// Temporary files of a killed run, beside the outputs of this one.
    Status remove_leftovers() {
        std::map<std::string, std::vector<std::string>> by_folder;
        for (const auto& item : items_)
            if (item->action != Action::none) {
                const fs::path path(item->row.output);
                by_folder[path.parent_path().string()].push_back(path.filename().string());
            }
        for (const auto& [folder, names] : by_folder) {
            std::error_code error;
            for (const auto& entry : fs::directory_iterator(in_destination(folder), error)) {
                const std::string name = entry.path().filename().string();
                if (name.front() != '.' || name.find(".tmp") == std::string::npos) continue;
                // .NAME.PID-COUNT.tmp.SUFFIX
                const auto tail = name.rfind(".tmp"), dot = tail == 0 ? tail : name.rfind('.', tail - 1);
                if (dot == std::string::npos || dot == 0) continue;
                const auto mark = std::string_view(name).substr(dot + 1, tail - dot - 1);
                if (mark.empty() || mark.find_first_not_of("0123456789-") != std::string_view::npos) continue;
                if (std::find(names.begin(), names.end(), name.substr(1, dot - 1)) != names.end())
                    ::unlink(entry.path().c_str());
            }
        }
        return {};
    }

    void work() {
        for (auto& item : items_)
            if (item->action == Action::convert && !item->donor) total_pixels_ += item->pixels;
        for (auto& item : items_)
            for (auto* follower : item->followers) total_pixels_ -= follower->pixels;
        for (const auto& item : items_) settle_total_ += item->other_shard ? 0 : 1;

        std::vector<Item*> queue;
        std::unordered_map<const Item*, bool> follows;
        for (auto& item : items_)
            for (auto* follower : item->followers) follows[follower] = true;
        for (auto& item : items_) {
            if (item->other_shard) continue;
            if (item->action == Action::none || options_.dry_run)
                settle(*item);
            else if (!follows.contains(item.get()))
                queue.push_back(item.get());
        }
        // The longest first: a large file begun last would leave every other thread without work.
        std::stable_sort(queue.begin(), queue.end(), [](const Item* a, const Item* b) { return a->pixels > b->pixels; });
        if (queue.empty()) return;

        const std::uint64_t budget = memory_budget();
        const auto jobs = static_cast<std::size_t>(options_.jobs > 0 ? options_.jobs : threads_);
        std::mutex mutex;
        std::uint64_t used = 0;
        std::size_t running = 0;
        TaskGroup group;
        // Each task takes files until none is left that fits; whoever frees memory starts tasks for what waited. A thread
        // without a file helps with the strips of the others' files.
        std::function<void()> take = [&] {
            for (;;) {
                Item* item = nullptr;
                bool last = false;
                {
                    const std::lock_guard lock(mutex);
                    if (running >= jobs) return;
                    for (auto it = queue.begin(); it != queue.end(); ++it)
                        if (running == 0 || used + (*it)->memory <= budget) {
                            item = *it;
                            queue.erase(it);
                            break;
                        }
                    if (!item) return;
                    ++running;
                    used += item->memory;
                    last = queue.size() < jobs;
                }
                tbb::this_task_arena::isolate([&] { perform(*item, last); });
                std::size_t idle = 0;
                {
                    const std::lock_guard lock(mutex);
                    --running;
                    used -= item->memory;
                    idle = queue.empty() ? 0 : std::min(jobs - running, queue.size());
                }
                for (std::size_t i = 1; i < idle; ++i) group.run([&] { take(); });
            }
        };
        arena_.execute([&] {
            for (std::size_t i = 0; i < std::min(jobs, queue.size()); ++i) group.run([&] { take(); });
            group.wait();
        });
    }

    std::uint64_t memory_budget() const {
        if (options_.memory > 0) return options_.memory;
        return static_cast<std::uint64_t>(::sysconf(_SC_PHYS_PAGES)) * static_cast<std::uint64_t>(::sysconf(_SC_PAGE_SIZE)) / 2;
    }

    void perform(Item& item, bool last) {
        if (item.action == Action::copy_data) {
            Status copied = copy_file(item.file.input, in_destination(item.row.output));
            if (copied) copied = note_output(item);
            if (!copied) fail(item, copied.error().message);
        } else if (!item.donor || !copy_output(item, *item.donor)) {
            convert(item, last);
        }
        settle(item);
        for (auto* follower : item.followers) {
            if (item.file.status == BatchStatus::failed)
                fail(*follower, item.file.reason);
            else if (!copy_output(*follower, item.row))
                convert(*follower, last);
            settle(*follower);
        }
    }

    Status note_output(Item& item) {
        const std::string path = in_destination(item.row.output);
        auto hash = hash_file(path);
        if (!hash) return Error{ErrorKind::output, hash.error().message};
        const auto stamp = stamp_of(path);
        if (!stamp) return Error{ErrorKind::output, fmt::format("{}: is gone as soon as it was written", path)};
        item.row.output_hash = *std::move(hash);
        item.row.output_stamp = *stamp;
        // Half of one content and half of another would pass for whole.
        if (stamp_of(item.file.input) != item.row.stamp)
            return Error{ErrorKind::input, fmt::format("{}: changed while it was read", item.file.input)};
        return {};
    }

    bool copy_output(Item& item, const Row& from) {
        if (!copy_file(in_destination(from.output), in_destination(item.row.output)) || !note_output(item) ||
            item.row.output_hash != from.output_hash)
            return false;
        item.row.out_of_gamut = from.out_of_gamut, item.row.nonfinite = from.nonfinite;
        item.row.measured_pixels = from.measured_pixels, item.row.changed_codes = from.changed_codes;
        item.row.mean = from.mean, item.row.p99 = from.p99, item.row.max = from.max;
        ++copied_;
        return true;
    }

    void convert(Item& item, bool last) {
        const auto begun = std::chrono::steady_clock::now();
        const std::string output = in_destination(item.row.output);
        if (auto s = make_folders(fs::path(output).parent_path().string()); !s) return fail(item, s.error().message);
        UpliftOptions o;
        o.job = options_.job;
        // The file libraries have threads of their own, which would come on top; they help where files alone keep no
        // thread busy.
        o.job.threads = last ? threads_ : 1;
        o.job.in_callers_arena = true;
        o.job.progress = [&](std::uint64_t done, std::uint64_t) {
            const auto step = done - item.done.exchange(done);
            const auto sum = done_pixels_.fetch_add(step) + step;
            if (!options_.job.progress) return;
            const std::lock_guard lock(progress_mutex_);
            options_.job.progress(sum, total_pixels_);
        };
        o.settings = options_.settings;
        o.settings.model = model_;
        o.layout = options_.layout;
        o.compression = options_.compression;
        o.check_all = options_.check_all;
        const auto made = uplift(item.file.input, output, o);
        if (!made) return fail(item, made.error().message);
        if (auto s = note_output(item); !s) return fail(item, s.error().message);
        Row& row = item.row;
        const auto& r = made->roundtrip;
        row.out_of_gamut = static_cast<std::int64_t>(made->input.out_of_gamut);
        row.nonfinite = static_cast<std::int64_t>(made->input.nonfinite);
        row.measured_pixels = static_cast<std::int64_t>(r.pixels);
        row.changed_codes = static_cast<std::int64_t>(r.changed_codes);
        row.mean = r.mean, row.p99 = r.p99, row.max = r.max;
        row.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
        computed_pixels_ += item.pixels;
    }

    /// The figures into the report's file, the row into the manifest.
    void settle(Item& item) {
        Row& row = item.row;
        BatchFile& f = item.file;
        const std::lock_guard lock(settle_mutex_);
        if (f.status == BatchStatus::failed) f.output.clear();
        f.width = row.width, f.height = row.height;
        f.output_hash = row.output_hash;
        f.nonfinite = static_cast<std::uint64_t>(row.nonfinite), f.out_of_gamut = static_cast<std::uint64_t>(row.out_of_gamut);
        f.measured = row.measured_pixels > 0;
        f.measured_pixels = static_cast<std::uint64_t>(row.measured_pixels);
        f.changed_codes = static_cast<std::uint64_t>(row.changed_codes);
        f.mean = row.mean, f.p99 = row.p99, f.max = row.max, f.seconds = row.seconds;
        // A file that is up to date stays `converted` in the manifest, as its row was copied.
        if (row.status.empty() || f.status == BatchStatus::failed) row.status = batch_status_name(f.status);
        ++settled_;
        if (options_.on_file) options_.on_file(f, settled_, settle_total_);
        if (!options_.dry_run && item.changed_row) note(item);
    }

    void note(Item& item) {
        if (item.before && !item.before->output.empty() && item.before->output != item.row.output &&
            !outputs_.contains(item.before->output))
            keep_first(manifest_->add_orphan(item.before->output, item.before->output_hash));
        if (!item.row.output.empty()) keep_first(manifest_->erase_orphan(item.row.output));
        keep_first(manifest_->put(item.row));
    }
    void keep_first(Status status) {
        if (!status && !manifest_error_) manifest_error_ = status.error();
    }

    Status finish() {
        for (auto& item : items_) {
            if (item->other_shard) {
                ++report_.other_shards;
                if (!options_.dry_run && (item->changed_row || seeded_)) keep_first(manifest_->put(item->row));
                continue;
            }
            // A shard that was seeded holds all that it has decided.
            if (seeded_ && !item->changed_row && !options_.dry_run) keep_first(manifest_->put(item->row));
            report_.files.push_back(std::move(item->file));
        }
        if (manifest_) keep_first(manifest_->flush());
        report_.files.insert(report_.files.end(), broken_.begin(), broken_.end());
        std::sort(report_.files.begin(), report_.files.end(), [](const auto& a, const auto& b) { return a.relative < b.relative; });
        for (const auto& f : report_.files) {
            auto& count = f.status == BatchStatus::converted ? report_.converted
                          : f.status == BatchStatus::skipped ? report_.skipped
                          : f.status == BatchStatus::data    ? report_.data
                                                             : report_.failed;
            ++count;
        }
        report_.copied = copied_;
        report_.pixels = computed_pixels_;
        return manifest_error_ ? Status(*manifest_error_) : Status();
    }

    const std::string source_, destination_;
    const BatchOptions& options_;
    const int threads_;
    tbb::task_arena arena_;
    std::unique_ptr<Manifest> manifest_;
    std::map<std::string, Row> rows_;
    bool seeded_ = false;
    std::shared_ptr<const Model> model_;
    std::string settings_text_;
    std::vector<std::unique_ptr<Item>> items_;
    std::vector<BatchFile> broken_;
    std::set<std::string> outputs_;  ///< names that some source has
    std::mutex settle_mutex_, progress_mutex_;
    std::size_t settled_ = 0, settle_total_ = 0;
    std::atomic<std::uint64_t> done_pixels_{0}, computed_pixels_{0};
    std::uint64_t total_pixels_ = 0;
    std::atomic<std::size_t> copied_{0};
    std::optional<Error> manifest_error_;
    BatchReport report_;
};

}  // namespace

std::string_view batch_status_name(BatchStatus status) {
    switch (status) {
    case BatchStatus::converted: return "converted";
    case BatchStatus::skipped: return "skipped";
    case BatchStatus::data: return "data";
    case BatchStatus::failed: break;
    }
    return "failed";
}

Result<Shard> parse_shard(std::string_view text) {
    const Error wrong{ErrorKind::usage, fmt::format("expected I/N with 0 <= I <= N <= 100000, got '{}'", text)};
    const auto slash = text.find('/');
    if (slash == std::string_view::npos) return wrong;
    int values[2] = {-1, -1};
    const std::string_view parts[2] = {text.substr(0, slash), text.substr(slash + 1)};
    for (int i = 0; i < 2; ++i) {
        const char* end = parts[i].data() + parts[i].size();
        const auto [at, error] = std::from_chars(parts[i].data(), end, values[i]);
        if (error != std::errc() || at != end) return wrong;
    }
    if (values[1] < 1 || values[1] > 100000 || values[0] < 0 || values[0] > values[1]) return wrong;
    return Shard{values[0] % values[1], values[1]};
}

Result<BatchReport> run_batch(const std::string& source, const std::string& destination, const BatchOptions& options) {
    return io::guarded(ErrorKind::output, destination,
                       [&]() -> Result<BatchReport> { return Run(source, destination, options).run(); });
}

}  // namespace spectex
