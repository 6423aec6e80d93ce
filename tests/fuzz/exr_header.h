// EXR files whose headers say whatever the input says, one line each, so that the search is for meanings and not for the bytes
// of OpenEXR's own layout.
//
//     h|f|u NAME     a channel of half, float, uint        s|i|n NAME=VALUE  an attribute of text, integer, number
//     w X Y W H      data window, at most 16 x 8           v NUMBER          value of the samples from here on
//     p NAME         another part from here on
#pragma once

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFloatAttribute.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfIntAttribute.h>
#include <OpenEXR/ImfMultiPartOutputFile.h>
#include <OpenEXR/ImfOutputPart.h>
#include <OpenEXR/ImfPartType.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <half.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <exception>
#include <string>
#include <vector>

#include "fuzz.h"
#include "spectex/pipeline.h"

namespace spectex::fuzz {

struct DescribedExr {
    std::string path;
    float largest = 0;  ///< magnitude of the samples; infinite where one is not finite
};

/// Nothing where the description is of no file.
inline std::optional<DescribedExr> write_exr(const Folder& folder, std::string_view text) {
    struct Part {
        Imf::Header header;
        std::vector<std::pair<std::string, float>> values;
    };
    std::vector<Part> parts(1);
    Imath::Box2i window({0, 0}, {4, 2});
    float value = 0.5f;
    DescribedExr made;
    int channels = 0, lines = 0;
    for (std::size_t at = 0; at < text.size() && ++lines < 400;) {
        const auto end = std::min(text.find('\n', at), text.size());
        const std::string line(text.substr(at, end - at));
        at = end + 1;
        if (line.size() < 3 || line[1] != ' ') continue;
        const std::string rest = line.substr(2);
        const auto sign = rest.find('=');
        const std::string name = rest.substr(0, sign), said = sign == std::string::npos ? "" : rest.substr(sign + 1);
        // OpenEXR ends names at a zero byte.
        if (name.empty() || name.size() > 255 || name.find('\0') != std::string::npos) continue;
        try {
            auto& header = parts.back().header;
            switch (line[0]) {
            case 'h': case 'f': case 'u':
                if (++channels > 64) return {};
                header.channels().insert(rest, Imf::Channel(line[0] == 'h' ? Imf::HALF : line[0] == 'f' ? Imf::FLOAT : Imf::UINT));
                parts.back().values.emplace_back(rest, value);
                break;
            case 's': header.insert(name, Imf::StringAttribute(said)); break;
            case 'i': header.insert(name, Imf::IntAttribute(std::atoi(said.c_str()))); break;
            case 'n': header.insert(name, Imf::FloatAttribute(std::strtof(said.c_str(), nullptr))); break;
            case 'v':
                value = std::strtof(rest.c_str(), nullptr);
                made.largest = std::max(made.largest, std::isfinite(value) ? std::abs(value) : INFINITY);
                break;
            case 'w': {
                int x = 0, y = 0, w = 1, h = 1;
                if (std::sscanf(rest.c_str(), "%d %d %d %d", &x, &y, &w, &h) == 4 && std::abs(x) < 1000000 && std::abs(y) < 1000000)
                    window = {{x, y}, {x + std::clamp(w, 1, 16) - 1, y + std::clamp(h, 1, 8) - 1}};
                break;
            }
            case 'p':
                if (parts.size() < 8) parts.emplace_back();
                parts.back().header.setName(rest);
                break;
            default: break;
            }
        } catch (const std::exception&) {
            return {};
        }
    }
    made.path = folder.write("described.exr", {});
    try {
        std::vector<Imf::Header> headers;
        for (auto& part : parts) {
            part.header.dataWindow() = window;
            part.header.displayWindow() = window;
            if (!part.header.hasName()) part.header.setName("first");
            part.header.setType(Imf::SCANLINEIMAGE);
            part.header.compression() = Imf::NO_COMPRESSION;
            headers.push_back(part.header);
        }
        Imf::MultiPartOutputFile file(made.path.c_str(), headers.data(), static_cast<int>(headers.size()), false, 0);
        for (std::size_t p = 0; p < parts.size(); ++p) {
            Imf::OutputPart out(file, static_cast<int>(p));
            Imf::FrameBuffer frame;
            const auto width = static_cast<std::size_t>(window.max.x - window.min.x + 1), pixels = width * static_cast<std::size_t>(window.max.y - window.min.y + 1);
            std::vector<std::vector<std::uint8_t>> planes;
            for (const auto& [name, v] : parts[p].values) {
                const auto type = parts[p].header.channels()[name].type;
                const half h(v);
                const std::uint32_t word = v >= 0 && v < 4e9f ? static_cast<std::uint32_t>(v) : 0;
                const std::size_t bytes = type == Imf::HALF ? 2 : 4;
                auto& plane = planes.emplace_back(pixels * bytes);
                for (std::size_t i = 0; i < pixels; ++i)
                    std::memcpy(plane.data() + i * bytes, type == Imf::HALF ? static_cast<const void*>(&h) : type == Imf::FLOAT ? static_cast<const void*>(&v) : &word, bytes);
                frame.insert(name, Imf::Slice::Make(type, plane.data(), window, bytes, bytes * width));
            }
            out.setFrameBuffer(frame);
            out.writePixels(window.max.y - window.min.y + 1);
        }
    } catch (const std::exception&) {
        return {};
    }
    return made;
}

/// Reads the file as everyone does: its kind, its spectra, and its look under a lamp.
inline void check_exr(const Folder& folder, const DescribedExr& file) {
    (void)probe(file.path);
    if (const auto reader = SpectralReader::open(file.path, 1)) {
        const auto& header = (*reader)->header();
        SPECTEX_FUZZ_CHECK(header.wavelengths_nm.size() + header.coefficients.size() >= 1);
        SPECTEX_FUZZ_CHECK(std::is_sorted(header.wavelengths_nm.begin(), header.wavelengths_nm.end()));
        SPECTEX_FUZZ_CHECK(header.others.size() == header.other_types.size());
    }
    RelightOptions options;
    options.job.threads = 1;
    static const auto lamp = *parse_illuminant("A");
    options.illuminants = {lamp};
    options.type = PixelType::float32;
    const std::string lit = folder.write("lit.exr", {});
    const auto report = relight(file.path, {lit}, options);
    if (!report) {
        SPECTEX_FUZZ_CHECK(report.error().message.find("described.exr") != std::string::npos);
        return;
    }
    const auto picture = ImageReader::open(lit, 1);
    SPECTEX_FUZZ_CHECK(picture.ok());
    const auto& header = (*picture)->header();
    std::vector<float> pixels(static_cast<std::size_t>(header.geometry.width) * static_cast<std::size_t>(header.geometry.height) *
                              header.channels.size());
    SPECTEX_FUZZ_CHECK(header.type == PixelType::float32);
    SPECTEX_FUZZ_CHECK((*picture)->read_rows(0, header.geometry.height, reinterpret_cast<std::byte*>(pixels.data())).ok());
    // Sums of a hundred bands of such samples stay far from the largest float.
    if (file.largest > 1e30f) return;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
        const auto channel = static_cast<int>(i % header.channels.size());
        const bool color = std::find(header.color.begin(), header.color.end(), channel) != header.color.end();
        SPECTEX_FUZZ_CHECK(!color || std::isfinite(pixels[i]));
    }
}

}  // namespace spectex::fuzz
