#include "files.h"

#include <fmt/format.h>
#include <glob.h>
#include <sys/stat.h>

#include <filesystem>
#include <map>

#include "text.h"

namespace spectex::app {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view placeholder = "{illuminant}";

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
    std::string out;
    const std::string part = file_name_part(illuminant);
    for (;;) {
        const auto at = path.find(placeholder);
        out += path.substr(0, at);
        if (at == std::string_view::npos) return out;
        out += part;
        path.remove_prefix(at + placeholder.size());
    }
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
                                      std::string_view suffix, std::span<const std::string> variants) {
    if (output.empty()) return Error{ErrorKind::usage, "-o: expected a file or folder name, got an empty one"};
    const bool placed = output.find(placeholder) != std::string_view::npos;
    std::vector<Job> jobs;
    std::vector<NamedOutput> named;
    const std::size_t count = variants.empty() ? 1 : variants.size();
    for (const auto& input : inputs) {
        Job job{input, {}};
        for (std::size_t i = 0; i < count; ++i) {
            const std::string target =
                variants.empty() ? std::string(output) : expand_illuminant(output, variants[i]);
            std::string path = target;
            if (is_folder(target)) {
                const std::string tag = variants.empty() || placed ? "" : fmt::format("_{}", file_name_part(variants[i]));
                path = (fs::path(target) / (stem(input) + tag + std::string(suffix))).string();
            } else if (inputs.size() > 1 || target.ends_with('/')) {
                if (fs::exists(target))
                    return Error{ErrorKind::usage, fmt::format("-o: '{}' is a file, but {} inputs need a folder", target,
                                                               inputs.size())};
                auto error = missing_folder(target);
                error.message = "-o: " + error.message;
                return error;
            } else if (variants.size() > 1 && !placed) {
                return Error{ErrorKind::usage, fmt::format("-o: {} illuminants need '{{illuminant}}' in the output's name, got '{}'",
                                                           variants.size(), target)};
            }
            named.push_back({fmt::format("'{}'{}", input, variants.size() > 1 ? fmt::format(" under {}", variants[i]) : ""), path});
            job.outputs.push_back(std::move(path));
        }
        jobs.push_back(std::move(job));
    }
    if (auto checked = check_outputs(inputs, named); !checked) return checked.error();
    return jobs;
}

}  // namespace spectex::app
