#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <system_error>

#include "methods/jakob2019.h"
#include "parallel.h"
#include "spectex/coefficient_table.h"
#include "spectex/io.h"

namespace spectex {
namespace {

static_assert(std::endian::native == std::endian::little, "coefficient tables are read and written in the machine's order");

constexpr std::size_t header_bytes = 8;
std::size_t file_bytes(std::size_t resolution) {
    return header_bytes + sizeof(float) * (resolution + 9 * resolution * resolution * resolution);
}

double smoothstep(double x) { return x * x * (3 - 2 * x); }

}  // namespace

Vector3 CoefficientTable::fetch(const Vector3& rgb) const {
    Vector3 p;
    for (std::size_t i = 0; i < 3; ++i) p[i] = rgb[i] > 0 ? std::min(rgb[i], 1.0) : 0;
    // Of equal components the last, as rgb2spec has it.
    std::size_t largest = 0;
    for (std::size_t i = 1; i < 3; ++i)
        if (p[i] >= p[largest]) largest = i;
    const std::size_t n = resolution;
    const double z = p[largest], last = static_cast<double>(n - 1);
    const std::array<double, 2> position{z > 0 ? p[(largest + 1) % 3] / z * last : 0, z > 0 ? p[(largest + 2) % 3] / z * last : 0};
    std::array<std::size_t, 3> cell{};
    std::array<double, 3> fraction{};
    for (std::size_t k = 0; k < 2; ++k) {
        cell[k] = std::min(static_cast<std::size_t>(position[k]), n - 2);
        fraction[k] = position[k] - static_cast<double>(cell[k]);
    }
    const auto above = static_cast<std::size_t>(
        std::upper_bound(scale.begin(), scale.end(), z, [](double v, float s) { return v < static_cast<double>(s); }) - scale.begin());
    cell[2] = std::clamp<std::size_t>(above, 1, n - 1) - 1;
    const double low = scale[cell[2]], high = scale[cell[2] + 1];
    fraction[2] = std::clamp((z - low) / (high - low), 0.0, 1.0);
    Vector3 c{};
    for (std::size_t corner = 0; corner < 8; ++corner) {
        const std::size_t dx = corner & 1, dy = corner >> 1 & 1, dz = corner >> 2;
        const double weight = (dx ? fraction[0] : 1 - fraction[0]) * (dy ? fraction[1] : 1 - fraction[1]) *
                              (dz ? fraction[2] : 1 - fraction[2]);
        const float* vertex = &data[3 * (((largest * n + cell[2] + dz) * n + cell[1] + dy) * n + cell[0] + dx)];
        for (std::size_t i = 0; i < 3; ++i) c[i] += weight * static_cast<double>(vertex[i]);
    }
    return c;
}

Result<CoefficientTable> make_coefficient_table(const Colorimetry& colorimetry, std::size_t resolution) {
    if (resolution < 2 || resolution > CoefficientTable::max_resolution)
        return Error{ErrorKind::usage, fmt::format("table resolution {}: expected 2..{}", resolution, CoefficientTable::max_resolution)};
    const auto solver = jakob2019::Solver::shared(colorimetry);
    const std::size_t n = resolution;
    const auto last = static_cast<double>(n - 1);
    CoefficientTable table;
    table.resolution = n;
    for (std::size_t k = 0; k < n; ++k)
        table.scale.push_back(static_cast<float>(smoothstep(smoothstep(static_cast<double>(k) / last))));
    table.data.resize(9 * n * n * n);
    const double first_step = n > 2 ? static_cast<double>(table.scale[1]) : 1.0 / 1024;
    parallel_for(std::size_t{0}, 3 * n * n, [&](std::size_t row) {
        const std::size_t largest = row / (n * n), k = row / n % n, y = row % n;
        std::vector<double> rgb(3 * n), c(3 * n);
        const double z = k == 0 ? first_step / 64 : static_cast<double>(table.scale[k]);
        for (std::size_t x = 0; x < n; ++x) {
            rgb[3 * x + largest] = z;
            rgb[3 * x + (largest + 1) % 3] = z * (static_cast<double>(x) / last);
            rgb[3 * x + (largest + 2) % 3] = z * (static_cast<double>(y) / last);
        }
        if (k == n - 1 && y == n - 1)
            for (std::size_t i = 0; i < 3; ++i) rgb[3 * (n - 1) + i] = 1 - first_step / 64;
        solver->solve(rgb, c);
        // c0 t^2 + c1 t + c2 with t = (l - o) / u.
        constexpr double o = jakob2019::origin_nm, u = jakob2019::unit_nm;
        for (std::size_t x = 0; x < n; ++x) {
            const double c0 = c[3 * x] / (u * u), c1 = c[3 * x + 1] / u;
            float* out = &table.data[3 * (row * n + x)];
            out[0] = static_cast<float>(c0);
            out[1] = static_cast<float>(c1 - 2 * c0 * o);
            out[2] = static_cast<float>(c[3 * x + 2] - c1 * o + c0 * o * o);
        }
    });
    return table;
}

Result<CoefficientTable> parse_coefficient_table(std::string_view bytes, std::string_view label) {
    const auto wrong = [&](std::string why) { return Error{ErrorKind::input, fmt::format("{}: {}", label, why)}; };
    if (bytes.size() < header_bytes || bytes.substr(0, 4) != "SPEC") return wrong("not a coefficient table: expected 'SPEC' at its start");
    std::uint32_t resolution = 0;
    std::memcpy(&resolution, bytes.data() + 4, sizeof resolution);
    if (resolution < 2 || resolution > CoefficientTable::max_resolution)
        return wrong(fmt::format("resolution {}: expected 2..{}", resolution, CoefficientTable::max_resolution));
    if (bytes.size() != file_bytes(resolution))
        return wrong(fmt::format("{} bytes: expected {} for the resolution {}", bytes.size(), file_bytes(resolution), resolution));
    CoefficientTable table;
    table.resolution = resolution;
    table.scale.resize(resolution);
    table.data.resize(9 * table.resolution * table.resolution * table.resolution);
    const char* at = bytes.data() + header_bytes;
    std::memcpy(table.scale.data(), at, table.scale.size() * sizeof(float));
    std::memcpy(table.data.data(), at + table.scale.size() * sizeof(float), table.data.size() * sizeof(float));
    for (std::size_t k = 0; k < table.scale.size(); ++k) {
        const float s = table.scale[k];
        if (!(s >= 0 && s <= 1) || (k > 0 && !(s > table.scale[k - 1])))
            return wrong(fmt::format("scale[{}] is {}: expected an ascending list within [0,1]", k, s));
    }
    for (std::size_t k = 0; k < table.data.size(); ++k)
        if (!std::isfinite(table.data[k])) return wrong(fmt::format("data[{}] is {}: expected finite numbers", k, table.data[k]));
    return table;
}

Result<CoefficientTable> read_coefficient_table(const std::string& path) {
    std::error_code failed;
    const auto size = std::filesystem::file_size(path, failed);
    if (failed) return Error{ErrorKind::input, fmt::format("{}: {}", path, failed.message())};
    // Before anything is read: a wrong name may be that of a file of any size.
    if (size > file_bytes(CoefficientTable::max_resolution))
        return Error{ErrorKind::input, fmt::format("{}: {} bytes: too large for a coefficient table", path, size)};
    std::string bytes(size, '\0');
    std::ifstream in(path, std::ios::binary);
    if (!in || !in.read(bytes.data(), static_cast<std::streamsize>(size)))
        return Error{ErrorKind::input, fmt::format("{}: cannot be read", path)};
    return parse_coefficient_table(bytes, path);
}

std::string coefficient_table_bytes(const CoefficientTable& table) {
    std::string bytes("SPEC");
    const auto append = [&](const void* from, std::size_t size) { bytes.append(static_cast<const char*>(from), size); };
    const auto resolution = static_cast<std::uint32_t>(table.resolution);
    append(&resolution, sizeof resolution);
    append(table.scale.data(), table.scale.size() * sizeof(float));
    append(table.data.data(), table.data.size() * sizeof(float));
    return bytes;
}

Status write_coefficient_table(const CoefficientTable& table, const std::string& path) {
    return write_text_file(path, coefficient_table_bytes(table));
}

}  // namespace spectex
