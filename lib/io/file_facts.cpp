// The few header fields of PNG that OpenImageIO does not hand on or answers itself, and declared lengths that the libraries of
// PNG and EXR would believe.
#include <fcntl.h>
#include <isa-l/crc.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>

#include "io/internal.h"

namespace spectex::io {
namespace {

class File {
public:
    explicit File(const std::string& path) : fd_(::open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
        struct stat s {};
        if (fd_ >= 0 && ::fstat(fd_, &s) == 0) size_ = static_cast<std::uint64_t>(s.st_size);
    }
    ~File() {
        if (fd_ >= 0) ::close(fd_);
    }
    File(const File&) = delete;
    File& operator=(const File&) = delete;
    bool is_open() const { return fd_ >= 0; }
    std::uint64_t size() const { return size_; }
    std::size_t read(std::uint64_t at, unsigned char* to, std::size_t n) const {
        std::size_t done = 0;
        while (done < n) {
            const ssize_t got = ::pread(fd_, to + done, n - done, static_cast<off_t>(at + done));
            if (got < 0 && errno == EINTR) continue;
            if (got <= 0) break;
            done += static_cast<std::size_t>(got);
        }
        return done;
    }

private:
    int fd_;
    std::uint64_t size_ = 0;
};

constexpr std::array<unsigned char, 8> png_signature{0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};

/// Table 11.1.
bool png_kind(unsigned bits, unsigned color_type) {
    switch (color_type) {
    case 0: return bits == 1 || bits == 2 || bits == 4 || bits == 8 || bits == 16;
    case 3: return bits == 1 || bits == 2 || bits == 4 || bits == 8;
    case 2:
    case 4:
    case 6: return bits == 8 || bits == 16;
    default: return false;
    }
}

// PNG (ISO/IEC 15948) section 11: the chunks before the image data.
Status read_png(const std::string& path, const File& file, FileFacts& facts) {
    facts.png = true;
    std::uint64_t at = png_signature.size();
    std::array<unsigned char, 40> c{};
    bool icc = false;
    for (int i = 0; i < 10000; ++i) {
        const std::size_t n = file.read(at, c.data(), c.size());
        if (n < 12) return {};
        const std::uint32_t length = be32(c.data());
        const std::string_view type(reinterpret_cast<const char*>(c.data()) + 4, 4);
        const unsigned char* body = c.data() + 8;
        if (type == "IDAT" || type == "IEND") break;
        if (length > file.size() - at - 12)
            return input_error(path, fmt::format("truncated or damaged: declares a chunk of {} bytes, {} before its end", length,
                                                 file.size() - at));
        if (type == "IHDR" && length == 13) {
            if (n < 25 || be32(body + 13) != crc32_gzip_refl(0, c.data() + 4, 17))
                return input_error(path, "damaged: the checksum of its header is wrong");
            const std::uint32_t width = be32(body), height = be32(body + 4);
            if (width < 1 || height < 1 || width > 0x7fffffffU || height > 0x7fffffffU)
                return input_error(path, fmt::format("declares a size of {} x {} pixels", width, height));
            if (!png_kind(body[8], body[9]) || body[10] != 0 || body[11] != 0 || body[12] > 1)
                return input_error(path, fmt::format("declares {} bits of colour type {}, methods {} {} {}, which no PNG has", body[8],
                                                     body[9], body[10], body[11], body[12]));
            facts.png_bits = body[8];
            facts.png_color_type = body[9];
            facts.png_interlaced = body[12] != 0;
        }
        if (type == "tRNS") facts.png_transparent = true;
        if (type == "sRGB" && length == 1) facts.srgb = true;
        if (type == "iCCP") icc = true;
        if (type == "gAMA" && length == 4 && be32(body) > 0) facts.gamma = 100000.0 / be32(body);
        if (type == "cHRM" && length == 32) {
            // White comes first in the file.
            std::array<double, 8> xy{};
            for (std::size_t k = 0; k < 8; ++k) xy[(k + 6) % 8] = be32(body + 4 * k) / 100000.0;
            facts.chromaticities = xy;
        }
        at += 12 + std::uint64_t{length};
    }
    // 11.3.3: iCCP and sRGB each take precedence over gAMA and cHRM.
    if (facts.srgb || icc) facts.gamma.reset(), facts.chromaticities.reset();
    return {};
}

bool starts(const unsigned char* head, std::size_t n, std::string_view magic) {
    return n >= magic.size() && std::memcmp(head, magic.data(), magic.size()) == 0;
}

}  // namespace

Result<FileFacts> read_file_facts(const std::string& path) {
    FileFacts facts;
    const File file(path);
    if (!file.is_open()) return input_error(path, errno_text(errno));
    std::array<unsigned char, 16> head{};
    const std::size_t n = file.read(0, head.data(), head.size());
    if (n >= 8 && std::memcmp(head.data(), png_signature.data(), 8) == 0) {
        if (auto ok = read_png(path, file, facts); !ok) return ok.error();
        facts.streams = !facts.png_interlaced;
    } else {
        using namespace std::string_view_literals;
        facts.streams = false;
        for (std::string_view magic : {"\xff\xd8"sv, "II*\0"sv, "MM\0*"sv, "II+\0"sv, "MM\0+"sv, "#?"sv, "SDPX"sv, "XPDS"sv, "P5"sv, "P6"sv,
                                       "Pf"sv, "PF"sv, "BM"sv})
            facts.streams = facts.streams || starts(head.data(), n, magic);
    }
    return facts;
}

// OpenEXR File Layout: attributes as name, type, size, value; an empty name ends a header, an empty header those of parts.
Status check_exr_header(const std::string& path) {
    const File file(path);
    if (!file.is_open()) return input_error(path, errno_text(errno));
    // Two names of at most 255 bytes, and the size.
    std::array<unsigned char, 520> c{};
    if (file.read(0, c.data(), 8) < 8) return {};  // the reader says why
    const bool parts = (c[5] & 0x10) != 0;
    const auto text = [&](std::size_t from, std::size_t n) {
        std::size_t end = from;
        while (end < n && c[end] != 0) ++end;
        return end;
    };
    bool empty = true;
    for (std::uint64_t at = 8; at < file.size();) {
        const std::size_t n = file.read(at, c.data(), c.size());
        if (n == 0) break;
        if (c[0] == 0) {
            if (!parts || empty) break;
            empty = true;
            ++at;
            continue;
        }
        empty = false;
        const std::size_t name = text(0, n), type = text(name + 1, n);
        if (type + 5 > n) break;
        const std::uint32_t size = std::uint32_t{c[type + 1]} | std::uint32_t{c[type + 2]} << 8 | std::uint32_t{c[type + 3]} << 16 |
                                   std::uint32_t{c[type + 4]} << 24;
        at += type + 5;
        const std::uint64_t left = file.size() - std::min(at, file.size());
        if (size > left)
            return input_error(path, fmt::format("truncated or damaged: its attribute '{}' declares {} bytes, {} before its end",
                                                 std::string_view(reinterpret_cast<const char*>(c.data()), name), size, left));
        at += size;
    }
    return {};
}

}  // namespace spectex::io
