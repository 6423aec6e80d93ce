// The few header fields of PNG and JPEG that OpenImageIO does not hand on or answers itself.
#include <fcntl.h>
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

std::uint32_t be32(const unsigned char* p) {
    return std::uint32_t{p[0]} << 24 | std::uint32_t{p[1]} << 16 | std::uint32_t{p[2]} << 8 | p[3];
}

constexpr std::array<unsigned char, 8> png_signature{0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};

// PNG (ISO/IEC 15948) section 11: the chunks before the image data.
void read_png(const File& file, FileFacts& facts) {
    facts.png = true;
    std::uint64_t at = png_signature.size();
    std::array<unsigned char, 40> c{};
    bool icc = false;
    for (int i = 0; i < 10000; ++i) {
        const std::size_t n = file.read(at, c.data(), c.size());
        if (n < 12) return;
        const std::uint32_t length = be32(c.data());
        const std::string_view type(reinterpret_cast<const char*>(c.data()) + 4, 4);
        const unsigned char* body = c.data() + 8;
        if (type == "IDAT" || type == "IEND") break;
        if (type == "IHDR" && length == 13) facts.png_interlaced = body[12] != 0;
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
}

// JPEG (ITU-T T.81) annex B. A decoder fills what is missing with grey, so the end marker is looked for here.
bool jpeg_is_complete(const File& file) {
    std::uint64_t at = 2;
    std::array<unsigned char, 4> m{};
    while (true) {  // segments up to the first scan
        if (file.read(at, m.data(), 4) < 4) return false;
        if (m[0] != 0xff) return false;
        if (m[1] == 0xff) {
            ++at;
            continue;
        }
        if (m[1] == 0xd9) return true;
        if (m[1] == 0xd8 || m[1] == 0x01 || (m[1] >= 0xd0 && m[1] <= 0xd7)) {
            at += 2;
            continue;
        }
        at += 2 + (std::uint64_t{m[2]} << 8 | m[3]);
        if (m[1] == 0xda) break;
    }
    // In entropy-coded data every 0xff is followed by 0 or a restart, so the end marker is unique; segments between the
    // scans of a progressive file are tables, which could hold it by chance only in their payload: skip them too.
    std::vector<unsigned char> block(std::size_t{1} << 16);
    while (true) {
        const std::size_t n = file.read(at, block.data(), block.size());
        if (n < 2) return false;
        std::size_t i = 0;
        bool moved = false;
        while (i + 1 < n) {
            const auto* hit = static_cast<const unsigned char*>(std::memchr(block.data() + i, 0xff, n - 1 - i));
            if (!hit) {
                i = n - 1;
                break;
            }
            i = static_cast<std::size_t>(hit - block.data());
            const unsigned char code = block[i + 1];
            if (code == 0xd9) return true;
            if (code == 0xff) {
                i += 1;
            } else if (code == 0 || (code >= 0xd0 && code <= 0xd7)) {
                i += 2;
            } else {
                std::array<unsigned char, 4> s{};
                if (file.read(at + i, s.data(), 4) < 4) return false;
                at += i + 2 + (std::uint64_t{s[2]} << 8 | s[3]);
                moved = true;
                break;
            }
        }
        if (!moved) at += std::max<std::size_t>(i, 1);
    }
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
        read_png(file, facts);
        facts.streams = !facts.png_interlaced;
    } else if (starts(head.data(), n, "\xff\xd8")) {
        if (!jpeg_is_complete(file)) return input_error(path, "is truncated: the JPEG has no end marker");
    } else {
        using namespace std::string_view_literals;
        facts.streams = false;
        for (std::string_view magic : {"II*\0"sv, "MM\0*"sv, "II+\0"sv, "MM\0+"sv, "#?"sv, "SDPX"sv, "XPDS"sv, "P5"sv, "P6"sv,
                                       "Pf"sv, "PF"sv, "BM"sv})
            facts.streams = facts.streams || starts(head.data(), n, magic);
    }
    return facts;
}

}  // namespace spectex::io
