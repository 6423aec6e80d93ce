#include "files.h"

#include <fmt/format.h>
#include <glob.h>
#include <sys/stat.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>

#include "text.h"

namespace spectex::app {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view placeholder = "{illuminant}", level_placeholder = "{mip}";

std::string replace_all(std::string_view text, std::string_view from, std::string_view to) {
    std::string out;
    for (;;) {
        const auto at = text.find(from);
        out += text.substr(0, at);
        if (at == std::string_view::npos) return out;
        out += to;
        text.remove_prefix(at + from.size());
    }
}

bool is_folder(const std::string& path) {
    std::error_code ignored;
    return fs::is_directory(path, ignored);
}

using FileId = std::pair<dev_t, ino_t>;

std::optional<FileId> file_id(const std::string& path) {
    struct stat status{};
    if (::stat(path.c_str(), &status) != 0) return std::nullopt;
    return FileId{status.st_dev, status.st_ino};
}

/// One spelling per place, whether or not a file is there yet.
std::string place(const std::string& path) {
    std::error_code code;
    const auto canonical = fs::weakly_canonical(path, code);
    return code ? path : canonical.string();
}

Error missing_folder(std::string_view folder) {
    return {ErrorKind::usage, fmt::format("the output folder '{}' is missing", folder)};
}

}  // namespace

Result<std::vector<std::string>> expand_inputs(std::span<const std::string> arguments) {
    std::vector<std::string> files;
    for (const auto& argument : arguments) {
        if (argument.empty()) return Error{ErrorKind::usage, "expected a file name, got an empty one"};
        struct stat status{};
        const bool there = ::lstat(argument.c_str(), &status) == 0;
        const auto first = files.size();
        if (!there && argument.find_first_of("*?[") != std::string::npos) {
            glob_t found{};
            if (::glob(argument.c_str(), 0, nullptr, &found) == 0)
                for (std::size_t i = 0; i < found.gl_pathc; ++i) files.emplace_back(found.gl_pathv[i]);
            ::globfree(&found);
            if (files.size() == first) return Error{ErrorKind::input, fmt::format("no file matches '{}'", argument)};
        } else {
            files.push_back(argument);
        }
        for (auto i = first; i < files.size(); ++i)
            if (is_folder(files[i])) return Error{ErrorKind::usage, fmt::format("expected a file, but '{}' is a folder", files[i])};
    }
    return files;
}

namespace {

std::optional<FileStamp> stamp_of(const std::string& path) {
    struct stat s{};
    if (::stat(path.c_str(), &s) != 0 || !S_ISREG(s.st_mode)) return std::nullopt;
    return FileStamp{static_cast<std::int64_t>(s.st_dev), static_cast<std::int64_t>(s.st_ino), s.st_size, s.st_mtim.tv_sec, s.st_mtim.tv_nsec};
}

/// As many bytes as tell nearly all textures of one size apart.
constexpr std::size_t head_bytes = std::size_t{1} << 12;

std::string head_of(const std::string& path) {
    std::string head(head_bytes, '\0');
    std::ifstream file(path, std::ios::binary);
    file.read(head.data(), static_cast<std::streamsize>(head.size()));
    head.resize(static_cast<std::size_t>(file.gcount()));
    return head;
}

}  // namespace

bool same_bytes(const std::string& a, const std::string& b) {
    std::ifstream files[] = {std::ifstream(a, std::ios::binary), std::ifstream(b, std::ios::binary)};
    std::vector<char> buffers[] = {std::vector<char>(std::size_t{1} << 16), std::vector<char>(std::size_t{1} << 16)};
    if (!files[0] || !files[1]) return false;
    for (;;) {
        for (std::size_t i = 0; i < 2; ++i) files[i].read(buffers[i].data(), static_cast<std::streamsize>(buffers[i].size()));
        const auto read = files[0].gcount();
        if (read != files[1].gcount() || files[0].bad() || files[1].bad()) return false;
        if (!std::equal(buffers[0].begin(), buffers[0].begin() + read, buffers[1].begin())) return false;
        if (static_cast<std::size_t>(read) < buffers[0].size()) return files[0].eof() && files[1].eof();
    }
}

std::optional<std::size_t> EqualFiles::number(const std::string& path) {
    const auto stamp = stamp_of(path);
    if (!stamp) return std::nullopt;
    std::optional<std::string> head;
    for (std::size_t i = 0; i < contents_.size(); ++i) {
        const Content& c = contents_[i];
        if (c.stamp[2] != (*stamp)[2]) continue;
        if (c.stamp != *stamp) {
            if (!head) head = head_of(path);
            if (*head != c.head || !same_bytes(path, c.path)) continue;
        }
        return stamp_of(c.path) == c.stamp && stamp_of(path) == stamp ? std::optional<std::size_t>(i) : std::nullopt;
    }
    contents_.push_back({path, head ? *std::move(head) : head_of(path), *stamp});
    return contents_.size() - 1;
}

std::string stem(std::string_view path) { return fs::path(path).stem().string(); }

std::string file_name_part(std::string_view name) {
    std::string out(name);
    for (char& c : out) {
        const bool plain = (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '.' ||
                           c == '_' || c == '-' || c == '+' || (static_cast<unsigned char>(c) & 0x80);
        if (!plain) c = '_';
    }
    if (out.starts_with('.') || out.starts_with('-')) out[0] = '_';
    return out.empty() ? "_" : out;
}

std::string expand_illuminant(std::string_view path, std::string_view illuminant) {
    return replace_all(path, placeholder, file_name_part(illuminant));
}

Status check_outputs(std::span<const std::string> inputs, std::span<const NamedOutput> outputs) {
    std::map<FileId, const std::string*> input_ids;
    for (const auto& input : inputs)
        if (const auto id = file_id(input)) input_ids.try_emplace(*id, &input);
    std::map<std::string, const NamedOutput*> places;
    for (const auto& output : outputs) {
        if (output.path.empty() || output.path == "-") continue;
        if (is_folder(output.path))
            return Error{ErrorKind::usage, fmt::format("{}: expected a file, but '{}' is a folder", output.option, output.path)};
        const auto folder = fs::path(output.path).parent_path().string();
        if (!folder.empty() && !is_folder(folder)) {
            auto error = missing_folder(folder);
            error.message = fmt::format("{}: {}", output.option, error.message);
            return error;
        }
        // Devices (/dev/null) may take any number of outputs.
        std::error_code ignored;
        if (fs::exists(output.path, ignored) && !fs::is_regular_file(output.path, ignored)) continue;
        if (const auto id = file_id(output.path))
            if (const auto same = input_ids.find(*id); same != input_ids.end())
                return Error{ErrorKind::usage, fmt::format("{}: the output '{}' is the input '{}', which is never modified",
                                                           output.option, output.path, *same->second)};
        const auto [at, added] = places.try_emplace(place(output.path), &output);
        if (!added)
            return Error{ErrorKind::usage, fmt::format("{} and {} would both write '{}'", at->second->option,
                                                       output.option, output.path)};
    }
    return {};
}

Result<std::vector<Job>> plan_outputs(std::span<const std::string> inputs, std::string_view output,
                                      std::string_view suffix, std::span<const std::string> variants, std::span<const int> levels) {
    if (output.empty()) return Error{ErrorKind::usage, "-o: expected a file or folder name, got an empty one"};
    const bool placed = output.find(placeholder) != std::string_view::npos, level_placed = output.find(level_placeholder) != std::string_view::npos;
    std::vector<Job> jobs;
    std::vector<NamedOutput> named;
    const std::size_t count = variants.empty() ? 1 : variants.size();
    static constexpr int full_size[] = {0};
    if (levels.empty()) levels = full_size;
    for (const auto& input : inputs)
        for (const int level : levels) {
            Job job{input, {}, level};
            for (std::size_t i = 0; i < count; ++i) {
                const std::string lit = variants.empty() ? std::string(output) : expand_illuminant(output, variants[i]);
                const std::string target = replace_all(lit, level_placeholder, std::to_string(level));
                std::string path = target;
                if (is_folder(target)) {
                    const std::string tag = variants.empty() || placed ? "" : fmt::format("_{}", file_name_part(variants[i]));
                    const std::string mip = levels.size() == 1 || level_placed ? "" : fmt::format("_mip{}", level);
                    path = (fs::path(target) / (stem(input) + mip + tag + std::string(suffix))).string();
                } else if (inputs.size() > 1 || target.ends_with('/')) {
                    if (fs::exists(target))
                        return Error{ErrorKind::usage, fmt::format("-o: '{}' is a file, but {} inputs need a folder", target,
                                                                   inputs.size())};
                    auto error = missing_folder(target);
                    error.message = "-o: " + error.message;
                    return error;
                } else if (levels.size() > 1 && !level_placed) {
                    return Error{ErrorKind::usage, fmt::format("-o: {} mip levels need '{{mip}}' in the output's name, got '{}'",
                                                               levels.size(), target)};
                } else if (variants.size() > 1 && !placed) {
                    return Error{ErrorKind::usage, fmt::format("-o: {} illuminants need '{{illuminant}}' in the output's name, got '{}'",
                                                               variants.size(), target)};
                }
                named.push_back({fmt::format("'{}'{}{}", input, levels.size() > 1 ? fmt::format(" level {}", level) : "",
                                             variants.size() > 1 ? fmt::format(" under {}", variants[i]) : ""), path});
                job.outputs.push_back(std::move(path));
            }
            jobs.push_back(std::move(job));
        }
    if (auto checked = check_outputs(inputs, named); !checked) return checked.error();
    return jobs;
}

}  // namespace spectex::app
