#include "table.h"

#include <fmt/format.h>

#include <filesystem>

#include "spectex/io.h"

namespace spectex::bench {

std::string Table::markdown() const {
    std::string out;
    for (std::size_t i = 0; i < rows_.size(); ++i) {
        for (const auto& cell : rows_[i]) out += "| " + cell + " ";
        out += "|\n";
        if (i == 0) {
            for (std::size_t c = 0; c < rows_[0].size(); ++c) out += "|---";
            out += "|\n";
        }
    }
    return out;
}

std::string Table::csv() const {
    std::string out;
    for (const auto& row : rows_) {
        for (std::size_t c = 0; c < row.size(); ++c) {
            const bool quoted = row[c].find_first_of(",\"\n") != std::string::npos;
            if (c > 0) out += ',';
            if (quoted) out += '"';
            for (const char ch : row[c]) {
                // Markdown's marks of code are none of the name's.
                if (ch == '`') continue;
                if (ch == '"') out += '"';
                out += ch;
            }
            if (quoted) out += '"';
        }
        out += "\n";
    }
    return out;
}

Status make_folder(const std::string& folder) {
    if (folder.empty()) return {};
    std::error_code failed;
    std::filesystem::create_directory(folder, failed);
    if (failed) return Error{ErrorKind::output, fmt::format("{}: {}", folder, failed.message())};
    return {};
}

int deliver(app::App& tool, const std::string& folder, const std::string& name, const Table& table, app::Json json) {
    const auto text = table.markdown();
    tool.out(text);
    if (!folder.empty()) {
        if (const auto made = make_folder(folder); !made) return tool.report(made.error(), folder);
        for (const auto& [suffix, content] : {std::pair<std::string, std::string>{".md", text}, {".csv", table.csv()}, {".json", json.dump(1) + "\n"}}) {
            const auto path = folder + "/" + name + suffix;
            if (const auto written = write_text_file(path, content); !written) return tool.report(written.error(), path);
        }
    }
    tool.record(std::move(json));
    return app::exit_ok;
}

}  // namespace spectex::bench
