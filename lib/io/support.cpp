#include "io/internal.h"

#include <OpenEXR/ImfThreading.h>
#include <OpenImageIO/imageio.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <mutex>
#include <system_error>
#include <thread>

#include <fmt/ranges.h>

namespace spectex {

std::size_t pixel_bytes(PixelType type) {
    switch (type) {
        case PixelType::uint8: return 1;
        case PixelType::uint16:
        case PixelType::half: return 2;
        case PixelType::float32: break;
    }
    return 4;
}

std::string_view pixel_type_name(PixelType type) {
    switch (type) {
        case PixelType::uint8: return "uint8";
        case PixelType::uint16: return "uint16";
        case PixelType::half: return "half";
        case PixelType::float32: break;
    }
    return "float";
}

bool same_file(const std::string& a, const std::string& b) {
    struct stat sa {}, sb {};
    const bool has_a = ::stat(a.c_str(), &sa) == 0, has_b = ::stat(b.c_str(), &sb) == 0;
    if (has_a && has_b) return sa.st_dev == sb.st_dev && sa.st_ino == sb.st_ino;
    if (has_a != has_b) return false;
    // Neither exists yet: two spellings of one future file.
    try {
        return std::filesystem::weakly_canonical(a) == std::filesystem::weakly_canonical(b);
    } catch (...) {
        return a == b;
    }
}

}  // namespace spectex

namespace spectex::io {

std::string errno_text(int code) { return std::generic_category().message(code); }

int prepare_threads(int threads) {
    static std::mutex mutex;
    static int pool = -1;
    const int cores = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
    const int wanted = threads > 0 ? std::min(threads, 1024) : cores;
    std::lock_guard lock(mutex);
    if (wanted > pool) {
        pool = wanted;
        Imf::setGlobalThreadCount(pool);
        OIIO::attribute("exr_threads", pool);
    }
    return wanted;
}

std::string lower(std::string_view text) {
    std::string out(text);
    for (char& c : out)
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    return out;
}

std::string suffix_of(std::string_view path) {
    const auto slash = path.find_last_of('/');
    const std::string_view name = slash == std::string_view::npos ? path : path.substr(slash + 1);
    const auto dot = name.find_last_of('.');
    if (dot == std::string_view::npos || dot == 0) return {};
    return lower(name.substr(dot));
}

Status check_readable(const std::string& path) {
    struct stat s {};
    if (::stat(path.c_str(), &s) != 0) return input_error(path, errno_text(errno));
    if (S_ISDIR(s.st_mode)) return input_error(path, "is a folder, not an image");
    if (!S_ISREG(s.st_mode)) return input_error(path, "is not a regular file");
    if (s.st_size == 0) return input_error(path, "is empty");
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) return input_error(path, errno_text(errno));
    ::close(fd);
    return {};
}

namespace {

/// Device, inode, size, time of change; all zero where there is no file.
std::array<std::int64_t, 5> state_of(const std::string& path) {
    struct stat s {};
    if (::stat(path.c_str(), &s) != 0) return {};
    return {static_cast<std::int64_t>(s.st_dev), static_cast<std::int64_t>(s.st_ino), s.st_size, s.st_mtim.tv_sec, s.st_mtim.tv_nsec};
}

}  // namespace

FileMark::FileMark(std::string path) : path_(std::move(path)), state_(state_of(path_)) {}

Status FileMark::check() const {
    if (state_of(path_) == state_) return {};
    return input_error(path_, "changed while it was read");
}

Result<bool> is_exr(const std::string& path) {
    if (auto ok = check_readable(path); !ok) return ok.error();
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) return input_error(path, errno_text(errno));
    unsigned char magic[4] = {};
    const ssize_t n = ::read(fd, magic, sizeof magic);
    const int code = errno;
    ::close(fd);
    if (n < 0) return input_error(path, errno_text(code));
    return n == 4 && magic[0] == 0x76 && magic[1] == 0x2f && magic[2] == 0x31 && magic[3] == 0x01;
}

Status check_limits(const std::string& path, const Limits& limits, std::int64_t width, std::int64_t height,
                    std::int64_t channels, std::int64_t pixel_bytes) {
    if (width < 1 || height < 1) return input_error(path, fmt::format("declares a size of {} x {} pixels", width, height));
    if (width > limits.max_width || height > limits.max_height)
        return input_error(path, fmt::format("declares {} x {} pixels; the limit is {} x {}", width, height,
                                             limits.max_width, limits.max_height));
    if (width > limits.max_pixels / height)
        return input_error(path, fmt::format("declares {} x {} pixels; the limit is {} pixels", width, height,
                                             limits.max_pixels));
    if (channels < 1) return input_error(path, "has no channels");
    if (channels > limits.max_channels)
        return input_error(path, fmt::format("declares {} channels; the limit is {}", channels, limits.max_channels));
    if (width > limits.max_row_bytes / std::max<std::int64_t>(1, pixel_bytes))
        return input_error(path, fmt::format("declares rows of {} pixels of {} bytes; the limit is {} bytes a row", width,
                                             pixel_bytes, limits.max_row_bytes));
    return {};
}

namespace {

struct Parsed {
    std::string layer, base, base_lower;
};

// Index of a name's channel within a layer; an exact spelling wins over another case.
int find(const std::vector<Parsed>& names, std::string_view layer, std::initializer_list<std::string_view> bases) {
    int loose = -1;
    for (std::string_view base : bases)
        for (std::size_t i = 0; i < names.size(); ++i) {
            if (names[i].layer != layer) continue;
            if (names[i].base == base) return static_cast<int>(i);
            if (loose < 0 && names[i].base_lower == lower(base)) loose = static_cast<int>(i);
        }
    return loose;
}

}  // namespace

Status check_level(const std::string& path, const ImageSelection& selection, int levels) {
    if (selection.mip < levels) return {};
    return input_error(path, levels == 1 ? fmt::format("has no mip levels, so no level {}: expected a file that has them, as maketx makes, or level 0",
                                                       selection.mip)
                                         : fmt::format("has no mip level {}: expected 0 to {}", selection.mip, levels - 1));
}

Status assign_channels(ImageHeader& header, const ImageSelection& selection) {
    std::vector<Parsed> names;
    for (const std::string& name : header.channels) {
        const auto dot = name.find_last_of('.');
        Parsed p;
        if (dot != std::string::npos) p.layer = name.substr(0, dot);
        p.base = dot == std::string::npos ? name : name.substr(dot + 1);
        p.base_lower = lower(p.base);
        names.push_back(std::move(p));
    }
    const auto take = [&](const std::string& layer) {
        const int r = find(names, layer, {"R", "red"}), g = find(names, layer, {"G", "green"}),
                  b = find(names, layer, {"B", "blue"});
        if (r < 0 || g < 0 || b < 0) return false;
        header.color = {r, g, b};
        header.alpha = find(names, layer, {"A", "alpha"});
        return true;
    };
    const auto take_grey = [&](const std::string& layer) {
        // Luminance beside BY and RY is not grey: the colour is in the two others, at a quarter of the resolution.
        const int y = find(names, layer, {"Y", "L", "I", "luminance", "gray", "grey"});
        if (y < 0 || find(names, layer, {"BY"}) >= 0 || find(names, layer, {"RY"}) >= 0) return false;
        header.color = {y, y, y};
        header.alpha = find(names, layer, {"A", "alpha"});
        return true;
    };
    header.color = {-1, -1, -1};
    header.alpha = -1;
    if (!selection.layer.empty()) {
        if (!take(selection.layer) && !take_grey(selection.layer))
            return input_error(header.path, fmt::format("has no layer '{0}' of colour: expected {0}.R, {0}.G, {0}.B or {0}.Y among its channels {1}",
                                                        selection.layer, fmt::join(header.channels, ", ")));
    } else if (!selection.channels.empty()) {
        std::vector<int> chosen;
        for (const auto& name : selection.channels) {
            const auto at = std::find(header.channels.begin(), header.channels.end(), name);
            if (at == header.channels.end())
                return input_error(header.path, fmt::format("has no channel '{}': expected one of {}", name, fmt::join(header.channels, ", ")));
            chosen.push_back(static_cast<int>(at - header.channels.begin()));
        }
        const bool grey = chosen.size() < 3;
        header.color = {chosen[0], chosen[grey ? 0 : 1], chosen[grey ? 0 : 2]};
        if (chosen.size() % 2 == 0) header.alpha = chosen.back();
    } else {
        bool found = take("") || take_grey("");
        const auto no_colour = {"z", "depth", "a", "alpha"};
        if (!found && names.size() == 1 && std::find(no_colour.begin(), no_colour.end(), names[0].base_lower) == no_colour.end()) {
            header.color = {0, 0, 0};
            found = true;
        }
        // Two channels of SGI and TGA are grey and alpha, though OpenImageIO calls them R and G.
        if (!found && names.size() == 2 && (header.format == "sgi" || header.format == "targa") && names[0].base == "R" && names[1].base == "G") {
            header.color = {0, 0, 0};
            header.alpha = 1;
            found = true;
        }
        for (std::size_t i = 0; !found && i < names.size(); ++i) found = take(names[i].layer);
    }
    header.others.clear();
    header.left_out.clear();
    if (selection.color_only && header.has_color()) header.alpha = -1;
    for (int i = 0; i < static_cast<int>(names.size()); ++i) {
        if (i == header.color[0] || i == header.color[1] || i == header.color[2]) continue;
        const bool wanted = i == header.alpha || !(selection.names_channels() || (selection.color_only && header.has_color()));
        if (wanted)
            header.others.push_back(i);
        else
            header.left_out.push_back(header.channels[static_cast<std::size_t>(i)]);
    }
    return {};
}

std::vector<int> drop_left_out(ImageHeader& header) {
    std::vector<int> kept, moved(header.channels.size(), -1);
    std::vector<std::string> names;
    for (int i = 0; i < static_cast<int>(header.channels.size()); ++i) {
        const bool wanted = i == header.color[0] || i == header.color[1] || i == header.color[2] ||
                            std::find(header.others.begin(), header.others.end(), i) != header.others.end();
        if (!wanted) continue;
        moved[static_cast<std::size_t>(i)] = static_cast<int>(kept.size());
        kept.push_back(i);
        names.push_back(header.channels[static_cast<std::size_t>(i)]);
    }
    const auto move = [&](int& index) {
        if (index >= 0) index = moved[static_cast<std::size_t>(index)];
    };
    for (int& index : header.color) move(index);
    for (int& index : header.others) move(index);
    move(header.alpha);
    header.channels = std::move(names);
    return kept;
}

}  // namespace spectex::io
