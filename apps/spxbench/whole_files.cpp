#include "whole_files.h"

#include <fmt/format.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "spectex/pipeline.h"

namespace spectex::bench {

using app::Json;

ScratchFolder::ScratchFolder(const std::string& beside) {
    std::error_code failed;
    const auto base = beside.empty() ? std::filesystem::temp_directory_path(failed) : std::filesystem::path(beside);
    path_ = (base / fmt::format(".spxbench-{}", ::getpid())).string();
    std::filesystem::create_directory(path_, failed);
    if (failed) error_ = failed.message();
}

ScratchFolder::~ScratchFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
}

Status ScratchFolder::status() const {
    if (error_.empty()) return {};
    return Error{ErrorKind::output, fmt::format("{}: {}", path_, error_)};
}

Result<std::map<std::string, Json>> read_baseline(const std::string& path, std::string_view what) {
    std::map<std::string, Json> rows;
    if (path.empty()) return rows;
    std::error_code failed;
    std::ifstream file;
    // A named pipe would be waited for.
    if (std::filesystem::is_regular_file(path, failed)) file.open(path, std::ios::binary);
    if (!file.is_open()) return Error{ErrorKind::input, fmt::format("{}: cannot be read", path)};
    const auto json = Json::parse(file, nullptr, false);
    if (!json.is_object() || !json.contains("what") || json["what"] != what || !json.contains("rows") || !json["rows"].is_array())
        return Error{ErrorKind::input, fmt::format("{}: expected the JSON of an earlier spxbench {}", path, what)};
    for (const auto& row : json["rows"])
        if (row.is_object() && row.contains("key") && row["key"].is_string()) rows[row["key"].get<std::string>()] = row;
    return rows;
}

std::string against(const std::map<std::string, Json>& baseline, const std::string& key, const char* member, double now) {
    const auto found = baseline.find(key);
    if (found == baseline.end() || !found->second.contains(member) || !found->second[member].is_number()) return "";
    const double before = found->second[member].get<double>();
    return before > 0 && now > 0 ? fmt::format("{:.2f}", before / now) : "";
}

Status draw(const std::string& folder, const std::string& name, const Chart& chart) {
    const auto svg = draw_chart_svg(chart);
    if (!svg) return svg.error();
    if (auto written = write_text_file(folder + "/" + name + ".svg", *svg); !written) return written;
    const auto picture = draw_chart(chart, 1.5);
    if (!picture) return picture.error();
    return write_picture(folder + "/" + name + ".png", *picture, 0);
}

}  // namespace spectex::bench
