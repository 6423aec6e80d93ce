// Command lines of every tool: an argument a line (or between zero bytes), the tool's name first. Each runs in a folder of its
// own, in which there are a texture, an EXR of each kind, a map, a lamp, a scene and a folder of textures.
//
// Whatever the line: no crash; an exit code of the contract; a sentence of the tool on standard error where it is not 0, and no
// control character on the terminal; inputs as they were, no temporary file left, nothing at all written by a wrong line.
//
// Options that have a model solved, for seconds, meet a folder without inputs; work that needs no input is left out.
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <map>
#include <vector>

#include "app.h"
#include "fuzz.h"

extern "C" __attribute__((weak)) void __sanitizer_set_report_fd(void* fd);

int spxbatch_main(int, char**);
int spxbench_main(int, char**);
int spxdiff_main(int, char**);
int spxheat_main(int, char**);
int spxinfo_main(int, char**);
int spxrelight_main(int, char**);
int spxsolve_main(int, char**);
int spxuplift_main(int, char**);

namespace {

namespace fs = std::filesystem;
using spectex::app::App;

struct Tool {
    std::string_view name;
    int (*main)(int, char**);
};
constexpr Tool tools[] = {{"spxbatch", spxbatch_main}, {"spxbench", spxbench_main},     {"spxdiff", spxdiff_main},   {"spxheat", spxheat_main},
                          {"spxinfo", spxinfo_main},   {"spxrelight", spxrelight_main}, {"spxsolve", spxsolve_main}, {"spxuplift", spxuplift_main}};

/// Takes what is written to a standard stream while it lives.
class Capture {
public:
    explicit Capture(int fd) : fd_(fd), before_(::dup(fd)), memory_(::memfd_create("stream", MFD_CLOEXEC)) {
        SPECTEX_FUZZ_CHECK(before_ >= 0 && memory_ >= 0 && ::dup2(memory_, fd_) == fd_);
    }
    ~Capture() {
        ::dup2(before_, fd_);
        ::close(before_);
        ::close(memory_);
    }
    Capture(const Capture&) = delete;
    Capture& operator=(const Capture&) = delete;
    std::string text() const {
        std::string out(static_cast<std::size_t>(::lseek(memory_, 0, SEEK_END)), '\0');
        SPECTEX_FUZZ_CHECK(::pread(memory_, out.data(), out.size(), 0) == static_cast<ssize_t>(out.size()));
        return out;
    }

private:
    int fd_, before_, memory_;
};

struct Ended {
    int code;
    std::string out, error;
};

Ended call(std::vector<std::string> arguments) {
    const auto tool = std::find_if(std::begin(tools), std::end(tools), [&](const Tool& t) { return t.name == arguments[0]; });
    std::vector<char*> argv;
    for (auto& a : arguments) argv.push_back(a.data());
    argv.push_back(nullptr);
    std::fflush(stdout);
    const Capture out(1), error(2);
    const int code = tool->main(static_cast<int>(arguments.size()), argv.data());
    std::fflush(stdout);
    return {code, out.text(), error.text()};
}

std::string content(const fs::path& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// root/work with the inputs, root/empty without.
class World {
public:
    World() {
        // A sanitizer's report must not end in what is taken of standard error.
        if (__sanitizer_set_report_fd) __sanitizer_set_report_fd(reinterpret_cast<void*>(static_cast<std::intptr_t>(::dup(2))));
        const int nothing = ::open("/dev/null", O_RDONLY);
        ::dup2(nothing, 0);
        ::close(nothing);
        App::lines_only = true;
        root_ = fs::path(folder_.write("beside", {})).parent_path();
        for (const char* name : {"work", "work/src", "work/sub", "empty"}) fs::create_directory(root_ / name);
        enter(work());
        const auto text = [](std::string_view name, std::string_view bytes) {
            std::ofstream(std::string(name), std::ios::binary) << bytes;
        };
        text("a.ppm", std::string_view("P6 2 2 255\n\xff\x80\x20\x10\x20\x30\x00\x00\x00\xff\xff\xff", 23));
        text("lamp.csv", "wavelength_nm,power\n380,1\n560,2\n780,1\n");
        text("scene.mtl", "newmtl brick\nmap_Kd src/b.png\n");
        made({"spxrelight", "a.ppm", "-i", "D65", "-o", "a.png"});
        made({"spxrelight", "a.ppm", "-i", "A", "-o", "src/b.png"});
        made({"spxuplift", "a.png", "-o", "c.exr"});
        made({"spxuplift", "a.png", "-o", "s.exr", "--store", "spectral"});
        made({"spxdiff", "a.png", "src/b.png", "--map", "m.exr"});
        for (const auto& entry : fs::recursive_directory_iterator("."))
            if (entry.is_regular_file()) inputs_[entry.path().string()] = content(entry.path());
        SPECTEX_FUZZ_CHECK(inputs_.size() == 8);
        leave();
    }

    fs::path work() const { return root_ / "work"; }
    fs::path empty() const { return root_ / "empty"; }
    static void enter(const fs::path& folder) { SPECTEX_FUZZ_CHECK(::chdir(folder.c_str()) == 0); }
    /// Back to where the process was begun: its own arguments may be relative.
    void leave() const { enter(start_); }

    /// @param wrong  whether the line was refused, so that nothing may have been written.
    void check_and_clean(bool wrong) const {
        std::size_t found = 0;
        std::vector<fs::path> written;
        for (const auto& top : {work(), empty()})
            for (const auto& entry : fs::recursive_directory_iterator(top)) {
                const auto path = "./" + entry.path().lexically_relative(top).string();
                const auto input = inputs_.find(path);
                if (top == work() && input != inputs_.end()) {
                    ++found;
                    SPECTEX_FUZZ_CHECK(content(entry.path()) == input->second);
                } else if (path != "./src" && path != "./sub") {
                    SPECTEX_FUZZ_CHECK(!wrong);
                    SPECTEX_FUZZ_CHECK(entry.path().filename().string().find(".tmp") == std::string::npos || !entry.path().filename().string().starts_with('.'));
                    written.push_back(entry.path());
                }
            }
        SPECTEX_FUZZ_CHECK(found == inputs_.size());
        SPECTEX_FUZZ_CHECK(std::distance(fs::directory_iterator(root_), fs::directory_iterator()) == 3);
        for (const auto& path : written) fs::remove_all(path);
    }

private:
    void made(const std::vector<std::string>& line) {
        const auto ended = call(line);
        if (ended.code != 0) std::fprintf(stderr, "%s", ended.error.c_str());
        SPECTEX_FUZZ_CHECK(ended.code == 0);
    }

    spectex::fuzz::Folder folder_;
    const fs::path start_ = fs::current_path();
    fs::path root_;
    std::map<std::string, std::string> inputs_;
};

/// Names stay below the folder: no leading bar, here or after whatever a tool splits arguments at, and no way up.
std::optional<std::string> kept_inside(std::string_view argument) {
    if (argument.find("..") != std::string_view::npos || argument.find('~') != std::string_view::npos) return {};
    std::string out;
    for (const char c : argument) {
        const auto plain = [](char d) { return (d >= 'a' && d <= 'z') || (d >= 'A' && d <= 'Z') || (d >= '0' && d <= '9') || d == '.' || d == '_' || d == '-'; };
        if (c == '/' && (out.empty() || !plain(out.back()))) continue;
        out += c;
    }
    return out;
}

/// What makes a tool solve for a spectrum other than those that come with it.
bool costly(std::string_view argument) {
    for (const std::string_view option : {"--method", "--bands", "--observer", "--illuminant", "--reference-illuminant", "--rgb-space", "--matrix", "--for",
                                          "--max-error", "--relight-observer", "--metamerism", "--threads", "--jobs", "--report"})
        if (argument.starts_with(option)) return true;
    return false;
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static const World world;
    const auto text = spectex::fuzz::text_of(data, size);
    const char separator = text.find('\0') == std::string_view::npos ? '\n' : '\0';
    std::vector<std::string> arguments;
    for (std::size_t at = 0; at <= text.size();) {
        const auto end = std::min(text.find(separator, at), text.size());
        const auto argument = kept_inside(text.substr(at, end - at));
        if (!argument || arguments.size() == 40) return 0;
        arguments.push_back(*argument);
        at = end + 1;
    }
    if (std::none_of(std::begin(tools), std::end(tools), [&](const Tool& t) { return t.name == arguments[0]; })) return 0;
    const bool slow = std::any_of(arguments.begin(), arguments.end(), costly);
    if (slow && std::any_of(arguments.begin(), arguments.end(), [](const auto& a) { return a.starts_with("--bake"); })) return 0;
    World::enter(slow ? world.empty() : world.work());
    const auto ended = call(arguments);
    world.leave();
    SPECTEX_FUZZ_CHECK(ended.code == 0 || ended.code == 1 || ended.code == 2 || ended.code == 64);
    const auto printable = [](const std::string& s) {
        return std::none_of(s.begin(), s.end(), [](char c) { return (static_cast<unsigned char>(c) < 0x20 && c != '\n') || c == 0x7f; });
    };
    SPECTEX_FUZZ_CHECK(printable(ended.error) && printable(ended.out));
    if (ended.code != 0) {
        const std::string head = arguments[0] + ": ";
        const auto at = ended.error.rfind('\n' + head) == std::string::npos ? ended.error.find(head) : ended.error.rfind('\n' + head) + 1;
        SPECTEX_FUZZ_CHECK(at != std::string::npos && ended.error.ends_with('\n') && ended.error.size() > at + head.size() + 10);
    }
    world.check_and_clean(ended.code == 64);
    return 0;
}
