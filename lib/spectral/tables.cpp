#include <dlfcn.h>
#include <fmt/format.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "embedded_luts.h"
#include "spectex/spectral.h"
#include "spectral/numeric.h"
#include "spectral/tables.h"

namespace spectex {
namespace {

namespace fs = std::filesystem;

bool is_file(const fs::path& path) {
    std::error_code ignored;
    return fs::is_regular_file(path, ignored);
}

/// share/spectex/luts beside the library or the binary that holds this code, when that file is there.
fs::path installed_path(std::string_view lut) {
    Dl_info info{};
    if (dladdr(reinterpret_cast<const void*>(&is_file), &info) == 0 || info.dli_fname == nullptr) return {};
    std::error_code failed;
    auto folder = fs::canonical(info.dli_fname, failed).parent_path();
    // lib/, lib64/ and Debian's lib/<triplet>/ lie at different depths below the prefix.
    for (int depth = 0; !failed && depth < 2 && folder.has_parent_path(); ++depth) {
        folder = folder.parent_path();
        const auto path = folder / "share" / "spectex" / "luts" / lut;
        if (is_file(path)) return path;
    }
    return {};
}

const EmbeddedLut* embedded(std::string_view path) {
    for (int i = 0; i < embedded_lut_count; ++i)
        if (path == embedded_luts[i].path) return &embedded_luts[i];
    return nullptr;
}

fs::path file_for(std::string_view path) {
    if (const char* folder = std::getenv("SPECTEX_LUTS"); folder != nullptr && *folder != '\0')
        if (const auto file = fs::path(folder) / path; is_file(file)) return file;
    return installed_path(path);
}

/// Splits a line of RFC 4180 fields. False on a quote that does not close.
bool split_csv_line(std::string_view line, std::vector<std::string>& fields) {
    fields.clear();
    std::string field;
    for (std::size_t i = 0;; ++i) {
        if (i < line.size() && line[i] == '"' && field.empty()) {
            for (++i;; ++i) {
                if (i >= line.size()) return false;
                if (line[i] == '"') {
                    if (i + 1 < line.size() && line[i + 1] == '"')
                        ++i;
                    else
                        break;
                }
                field += line[i];
            }
        } else if (i >= line.size() || line[i] == ',') {
            fields.push_back(std::move(field));
            field.clear();
            if (i >= line.size()) return true;
        } else {
            field += line[i];
        }
    }
}

}  // namespace

Result<std::string> read_text(const std::string& path, std::uintmax_t most) {
    std::error_code failed;
    const auto bytes = std::filesystem::file_size(path, failed);
    if (failed) return Error{ErrorKind::input, fmt::format("{}: not a readable file", path)};
    if (bytes > most)
        return Error{ErrorKind::input, fmt::format("{}: {} bytes, expected a spectrum of at most {}", path, bytes, most)};
    std::ifstream in(path, std::ios::binary);
    std::ostringstream text;
    text << in.rdbuf();
    if (!in) return Error{ErrorKind::input, fmt::format("{}: cannot be read", path)};
    return text.str();
}

Result<std::string> lut_text(std::string_view path) {
    if (const auto file = file_for(path); !file.empty()) {
        std::ifstream in(file, std::ios::binary);
        std::ostringstream text;
        text << in.rdbuf();
        if (!in || !text) return Error{ErrorKind::input, fmt::format("{}: cannot be read", file.string())};
        return text.str();
    }
    if (const auto* lut = embedded(path)) return std::string(lut->begin, lut->end);
    return Error{ErrorKind::input, fmt::format("data file {}: neither in the folder SPECTEX_LUTS, nor beside the library, nor "
                                               "built in",
                                               path)};
}

std::string lut_origin(std::string_view path) {
    const auto file = file_for(path);
    return file.empty() ? "built in" : file.string();
}

Result<std::vector<std::vector<std::string>>> parse_csv(std::string_view text, std::string_view label) {
    std::vector<std::vector<std::string>> rows;
    std::size_t number = 0;
    while (!text.empty()) {
        ++number;
        const auto end = text.find('\n');
        auto line = text.substr(0, end);
        text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
        if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
        if (line.empty()) continue;
        rows.emplace_back();
        if (!split_csv_line(line, rows.back()))
            return Error{ErrorKind::input, fmt::format("{}: line {}: a quoted field is not closed", label, number)};
        if (rows.back().size() != rows.front().size())
            return Error{ErrorKind::input, fmt::format("{}: line {}: {} fields, expected {} as in the header", label, number,
                                                       rows.back().size(), rows.front().size())};
    }
    return rows;
}

Result<SpectralTable> parse_spectral_csv(std::string_view text, std::string_view label) {
    auto parsed = parse_csv(text, label);
    if (!parsed) return std::move(parsed).error();
    const auto& rows = *parsed;
    if (rows.empty() || rows[0].size() < 2 || rows[0][0] != "wavelength_nm")
        return Error{ErrorKind::input, fmt::format("{}: line 1: expected a header 'wavelength_nm,NAME,...'", label)};
    SpectralTable table;
    table.names.assign(rows[0].begin() + 1, rows[0].end());
    table.columns.resize(table.names.size());
    for (std::size_t r = 1; r < rows.size(); ++r) {
        const auto wrong = [&](const std::string& why) {
            return Error{ErrorKind::input, fmt::format("{}: row {} of numbers: {}", label, r, why)};
        };
        const auto wavelength = parse_number(rows[r][0]);
        if (!wavelength || *wavelength <= 0) return wrong(fmt::format("'{}' is no wavelength in nm", rows[r][0]));
        if (!table.wavelengths_nm.empty() && *wavelength <= table.wavelengths_nm.back())
            return wrong(fmt::format("{} nm does not lie above {} nm", *wavelength, table.wavelengths_nm.back()));
        table.wavelengths_nm.push_back(*wavelength);
        for (std::size_t c = 0; c < table.columns.size(); ++c) {
            const auto value = parse_number(rows[r][c + 1]);
            if (!value) return wrong(fmt::format("'{}' in column {} is no finite number", rows[r][c + 1], table.names[c]));
            table.columns[c].push_back(*value);
        }
    }
    if (table.wavelengths_nm.empty()) return Error{ErrorKind::input, fmt::format("{}: no rows of numbers", label)};
    return table;
}

Result<SpectralTable> load_spectral_table(std::string_view lut_path) {
    auto text = lut_text(lut_path);
    if (!text) return std::move(text).error();
    return parse_spectral_csv(*text, lut_path);
}

Result<SpectralTable> read_spectral_csv(const std::string& path) {
    const auto text = read_text(path);
    if (!text) return text.error();
    return parse_spectral_csv(*text, path);
}

}  // namespace spectex
