#include "batch/small_png.h"

#include <isa-l/crc.h>

#include <algorithm>
#include <cstring>
#include <map>

#include "io/deflate.h"

namespace spectex::batch {
namespace {

struct Color {
    Rgb8 code{};
    std::uint64_t pixels = 0;
};

/// Colours [begin, end) of the list, as one entry of the palette.
struct Group {
    std::size_t begin = 0, end = 0;
    double spread = 0;  ///< sum of squared distances to the mean along the widest axis
    std::size_t axis = 0;
};

Group measured(const std::vector<Color>& colors, std::size_t begin, std::size_t end) {
    Group group{begin, end, 0, 0};
    for (std::size_t c = 0; c < 3; ++c) {
        double n = 0, sum = 0, squares = 0;
        for (std::size_t i = begin; i < end; ++i) {
            const auto w = static_cast<double>(colors[i].pixels), v = static_cast<double>(colors[i].code[c]);
            n += w, sum += w * v, squares += w * v * v;
        }
        const double spread = squares - sum * sum / n;
        if (spread > group.spread) group.spread = spread, group.axis = c;
    }
    return group;
}

Rgb8 mean_of(const std::vector<Color>& colors, const Group& group) {
    Rgb8 mean{};
    for (std::size_t c = 0; c < 3; ++c) {
        std::uint64_t n = 0, sum = 0;
        for (std::size_t i = group.begin; i < group.end; ++i) n += colors[i].pixels, sum += colors[i].pixels * colors[i].code[c];
        mean[c] = static_cast<std::uint8_t>((sum + n / 2) / n);
    }
    return mean;
}

/// Sorted, so that the same picture gives the same bytes.
std::vector<Rgb8> palette_of(std::vector<Color> colors, std::size_t most) {
    std::vector<Rgb8> palette;
    if (colors.size() <= most) {
        for (const auto& color : colors) palette.push_back(color.code);
        return palette;
    }
    std::vector<Group> groups{measured(colors, 0, colors.size())};
    while (groups.size() < most) {
        const auto widest = std::max_element(groups.begin(), groups.end(), [](const auto& a, const auto& b) { return a.spread < b.spread; });
        if (widest->spread <= 0) break;
        const Group group = *widest;
        const auto at = [&](std::size_t i) { return colors.begin() + static_cast<std::ptrdiff_t>(i); };
        std::sort(at(group.begin), at(group.end), [&](const Color& a, const Color& b) {
            return a.code[group.axis] != b.code[group.axis] ? a.code[group.axis] < b.code[group.axis] : a.code < b.code;
        });
        std::uint64_t half = 0, passed = 0;
        for (std::size_t i = group.begin; i < group.end; ++i) half += colors[i].pixels;
        std::size_t cut = group.begin;
        while (cut + 1 < group.end && 2 * (passed + colors[cut].pixels) <= half) passed += colors[cut++].pixels;
        cut = std::max(cut, group.begin + 1);
        *widest = measured(colors, group.begin, cut);
        groups.push_back(measured(colors, cut, group.end));
    }
    for (const auto& group : groups) palette.push_back(mean_of(colors, group));
    std::sort(palette.begin(), palette.end());
    palette.erase(std::unique(palette.begin(), palette.end()), palette.end());
    return palette;
}

void put32(std::vector<std::uint8_t>& out, std::uint32_t v) {
    for (int shift = 24; shift >= 0; shift -= 8) out.push_back(static_cast<std::uint8_t>(v >> shift));
}
void put_chunk(std::vector<std::uint8_t>& out, const char* name, const std::vector<std::uint8_t>& data) {
    put32(out, static_cast<std::uint32_t>(data.size()));
    const std::size_t from = out.size();
    out.insert(out.end(), name, name + 4);
    out.insert(out.end(), data.begin(), data.end());
    put32(out, crc32_gzip_refl(0, out.data() + from, out.size() - from));
}

}  // namespace

std::vector<std::uint8_t> small_png(const Picture& picture, int colors) {
    std::map<Rgb8, std::uint64_t> counted;
    const std::size_t n = picture.rgb.size() / 3;
    const auto code = [&](std::size_t i) { return Rgb8{picture.rgb[3 * i], picture.rgb[3 * i + 1], picture.rgb[3 * i + 2]}; };
    for (std::size_t i = 0; i < n; ++i) ++counted[code(i)];
    std::vector<Color> list;
    for (const auto& [rgb, pixels] : counted) list.push_back({rgb, pixels});
    const auto palette = palette_of(std::move(list), static_cast<std::size_t>(std::clamp(colors, 2, 256)));

    std::map<Rgb8, std::uint8_t> index;
    for (const auto& [rgb, pixels] : counted) {
        int best = 1 << 30;
        for (std::size_t p = 0; p < palette.size(); ++p) {
            int distance = 0;
            for (std::size_t c = 0; c < 3; ++c) distance += (rgb[c] - palette[p][c]) * (rgb[c] - palette[p][c]);
            if (distance < best) best = distance, index[rgb] = static_cast<std::uint8_t>(p);
        }
    }
    const int bits = palette.size() <= 2 ? 1 : palette.size() <= 4 ? 2 : palette.size() <= 16 ? 4 : 8;
    std::vector<std::uint8_t> rows;
    for (std::size_t y = 0, i = 0; y < static_cast<std::size_t>(picture.height); ++y) {
        rows.push_back(0);
        int free = 0;
        for (int x = 0; x < picture.width; ++x, ++i) {
            if (free == 0) rows.push_back(0), free = 8;
            free -= bits;
            rows.back() = static_cast<std::uint8_t>(rows.back() | index[code(i)] << free);
        }
    }
    std::vector<std::uint8_t> head, table, data(std::begin(io::zlib_head), std::end(io::zlib_head));
    put32(head, static_cast<std::uint32_t>(picture.width));
    put32(head, static_cast<std::uint32_t>(picture.height));
    // Palette (3), deflate, the five filters, not interlaced.
    head.insert(head.end(), {static_cast<std::uint8_t>(bits), 3, 0, 0, 0});
    for (const auto& rgb : palette) table.insert(table.end(), rgb.begin(), rgb.end());
    io::deflate_append(rows.data(), rows.size(), true, data);
    put32(data, io::adler32(rows.data(), rows.size()));
    std::vector<std::uint8_t> out{0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
    put_chunk(out, "IHDR", head);
    put_chunk(out, "PLTE", table);
    put_chunk(out, "IDAT", data);
    put_chunk(out, "IEND", {});
    return out;
}

std::string base64(const std::vector<std::uint8_t>& bytes) {
    static constexpr char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string out;
    out.reserve((bytes.size() + 2) / 3 * 4);
    for (std::size_t i = 0; i < bytes.size(); i += 3) {
        const std::size_t left = std::min<std::size_t>(3, bytes.size() - i);
        std::uint32_t v = 0;
        for (std::size_t k = 0; k < 3; ++k) v = v << 8 | (k < left ? bytes[i + k] : 0U);
        for (std::size_t k = 0; k < 4; ++k) out += k <= left ? digits[v >> (18 - 6 * k) & 63] : '=';
    }
    return out;
}

}  // namespace spectex::batch
