// Temporary files beside their destinations, and the registry that a signal handler can clear.
#include <dirent.h>
#include <fcntl.h>
#include <linux/fs.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <charconv>
#include <climits>
#include <cstdlib>
#include <map>
#include <mutex>

#include "io/internal.h"

namespace spectex {
namespace {

using io::errno_text;
using io::output_error;

// A handler may neither lock nor allocate: fixed slots, each with a state that one compare-and-swap changes. The process
// is noted so that a forked child does not remove its parent's files.
struct Slot {
    std::atomic<int> state{0};
    pid_t process = 0;
    int lock = -1;  ///< an open file whose lock says that this one is being written
    char path[PATH_MAX];
};
enum { slot_free = 0, slot_changing = 1, slot_live = 2 };
constexpr std::size_t slot_count = 256;
Slot slots[slot_count];
static_assert(std::atomic<int>::is_always_lock_free);

int register_path(const std::string& path) {
    for (std::size_t i = 0; i < slot_count; ++i) {
        Slot& slot = slots[i];
        int expected = slot_free;
        if (!slot.state.compare_exchange_strong(expected, slot_changing)) continue;
        slot.process = ::getpid();
        std::memcpy(slot.path, path.c_str(), path.size() + 1);
        slot.state.store(slot_live);
        return static_cast<int>(i);
    }
    return -1;
}

void release(int slot) {
    if (slots[slot].lock >= 0) ::close(std::exchange(slots[slot].lock, -1));
    slots[slot].state.store(slot_free);
}

std::string folder_of(const std::string& path) {
    const auto slash = path.find_last_of('/');
    if (slash == std::string::npos) return ".";
    return slash == 0 ? "/" : path.substr(0, slash);
}

// A link is written through, so that it keeps pointing where it did; the target need not exist yet.
Result<std::string> follow_links(const std::string& destination) {
    std::string path = destination;
    for (int depth = 0; depth < 40; ++depth) {
        struct stat s {};
        if (::lstat(path.c_str(), &s) != 0 || !S_ISLNK(s.st_mode)) return path;
        char target[PATH_MAX];
        const ssize_t n = ::readlink(path.c_str(), target, sizeof target);
        if (n < 0 || n == static_cast<ssize_t>(sizeof target))
            return output_error(destination, "cannot follow the symbolic link: " + errno_text(errno));
        const std::string to(target, static_cast<std::size_t>(n));
        path = !to.empty() && to.front() == '/' ? to : folder_of(path) + "/" + to;
    }
    return output_error(destination, errno_text(ELOOP));
}

/// Temporary files of processes that were killed: named after this destination, locked by nobody, their process gone. A folder
/// is listed once for all outputs.
void remove_leftovers(const std::string& folder, const std::string& name, const std::string& suffix) {
    static std::mutex mutex;
    static std::map<std::string, std::vector<std::string>, std::less<>> listed;
    const std::lock_guard lock(mutex);
    const auto [entry, fresh] = listed.try_emplace(folder);
    auto& names = entry->second;
    if (fresh) {
        DIR* dir = ::opendir(folder.c_str());
        if (!dir) return;
        while (const dirent* file = ::readdir(dir)) {
            const std::string_view found = file->d_name;
            if (found.starts_with('.') && found.find(".tmp") != std::string_view::npos) names.emplace_back(found);
        }
        ::closedir(dir);
    }
    std::erase_if(names, [&](const std::string& found) {
        const std::string head = "." + name + ".", tail = ".tmp" + suffix;
        if (!found.starts_with(head) || !found.ends_with(tail) || found.size() <= head.size() + tail.size()) return false;
        const std::string_view mark(found.data() + head.size(), found.size() - head.size() - tail.size());
        pid_t process = 0;
        unsigned count = 0;
        const auto [dash, failed] = std::from_chars(mark.data(), mark.data() + mark.size(), process);
        if (failed != std::errc() || dash == mark.data() + mark.size() || *dash != '-' || process <= 0) return false;
        const auto [end, wrong] = std::from_chars(dash + 1, mark.data() + mark.size(), count);
        if (wrong != std::errc() || end != mark.data() + mark.size()) return false;
        if (::kill(process, 0) == 0 || errno != ESRCH) return false;
        const std::string path = folder + "/" + found;
        const int fd = ::open(path.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
        if (fd < 0) return true;
        struct stat s {};
        // Another machine, or another container, may be writing it.
        if (::fstat(fd, &s) == 0 && S_ISREG(s.st_mode) && ::flock(fd, LOCK_EX | LOCK_NB) == 0) ::unlink(path.c_str());
        ::close(fd);
        return true;
    });
}

// Some file systems know no fsync of folders; the rename is then as durable as they make it.
Status sync_folder(const std::string& path, const std::string& folder) {
    const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) return {};
    const int failed = ::fsync(fd);
    const int code = errno;
    ::close(fd);
    if (failed != 0 && code != EINVAL && code != ENOTSUP && code != EROFS)
        return output_error(path, "cannot flush its folder: " + errno_text(code));
    return {};
}

}  // namespace

Result<OutputFile> OutputFile::create(const std::string& destination) {
    return io::guarded(ErrorKind::output, destination, [&]() -> Result<OutputFile> {
        if (destination.empty()) return Error{ErrorKind::usage, "an output needs a name"};
        if (destination.back() == '/')
            return Error{ErrorKind::usage, fmt::format("{}: names a folder where a file is expected", destination)};
        auto target = follow_links(destination);
        if (!target) return target.error();
        const std::string folder = folder_of(*target);
        struct stat s {};
        if (::stat(folder.c_str(), &s) != 0) {
            if (errno == ENOENT || errno == ENOTDIR)
                return Error{ErrorKind::usage, fmt::format("{}: there is no folder '{}'", destination, folder)};
            return output_error(destination, errno_text(errno));
        }
        if (!S_ISDIR(s.st_mode))
            return Error{ErrorKind::usage, fmt::format("{}: '{}' is not a folder", destination, folder)};
        if (::stat(target->c_str(), &s) == 0) {
            if (S_ISDIR(s.st_mode))
                return Error{ErrorKind::usage, fmt::format("{}: names a folder where a file is expected", destination)};
            if (!S_ISREG(s.st_mode)) return output_error(destination, "is not a regular file, so it cannot be replaced");
            if (::access(target->c_str(), W_OK) != 0) return output_error(destination, errno_text(errno));
        }
        const auto slash = target->find_last_of('/');
        std::string name = slash == std::string::npos ? *target : target->substr(slash + 1);
        if (name.size() > NAME_MAX) return output_error(destination, errno_text(ENAMETOOLONG));
        const std::string prefix = slash == std::string::npos ? "" : target->substr(0, slash + 1);
        const auto dot = name.find_last_of('.');
        const std::string suffix = dot == std::string::npos || dot == 0 ? "" : name.substr(dot);
        if (name.size() + 40 + suffix.size() > NAME_MAX)
            name.resize(NAME_MAX > 40 + suffix.size() ? NAME_MAX - 40 - suffix.size() : 1);

        remove_leftovers(folder, name, suffix);

        static std::atomic<unsigned> counter{0};
        for (int attempt = 0; attempt < 1000; ++attempt) {
            const std::string temporary =
                fmt::format("{}.{}.{}-{}.tmp{}", prefix, name, ::getpid(), counter.fetch_add(1), suffix);
            if (temporary.size() >= PATH_MAX) return output_error(destination, errno_text(ENAMETOOLONG));
            // Registered first: a signal between the two calls must not leave the file behind.
            const int slot = register_path(temporary);
            if (slot < 0)
                return output_error(destination, fmt::format("more than {} outputs are open at once", slot_count));
            const int fd = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
            if (fd < 0) {
                const int code = errno;
                release(slot);
                if (code == EEXIST) continue;
                return output_error(destination, errno_text(code));
            }
            // Where a file system knows no locks, leftovers are told by their process alone.
            (void)!::flock(fd, LOCK_EX | LOCK_NB);
            slots[slot].lock = fd;
            OutputFile file;
            file.temporary_ = temporary;
            file.destination_ = destination;
            file.target_ = *target;
            file.slot_ = slot;
            return file;
        }
        return output_error(destination, "every temporary name beside it is taken");
    });
}

OutputFile::~OutputFile() {
    if (temporary_.empty()) return;
    ::unlink(temporary_.c_str());
    release(slot_);
}

OutputFile::OutputFile(OutputFile&& other) noexcept
    : temporary_(std::exchange(other.temporary_, {})),
      destination_(std::exchange(other.destination_, {})),
      target_(std::exchange(other.target_, {})),
      slot_(std::exchange(other.slot_, -1)) {}

OutputFile& OutputFile::operator=(OutputFile&& other) noexcept {
    std::swap(temporary_, other.temporary_);
    std::swap(destination_, other.destination_);
    std::swap(target_, other.target_);
    std::swap(slot_, other.slot_);
    return *this;
}

Status OutputFile::commit() {
    if (temporary_.empty()) return output_error(destination_, "is committed already");
    const int fd = ::open(temporary_.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) return output_error(destination_, "its temporary file is gone: " + errno_text(errno));
    struct stat s {};
    if (::stat(target_.c_str(), &s) == 0) (void)!::fchmod(fd, s.st_mode & 07777);
    int failed = ::fsync(fd);
    int code = errno;
    if (::close(fd) != 0 && failed == 0) failed = -1, code = errno;
    if (failed != 0) return output_error(destination_, "cannot flush: " + errno_text(code));
    if (::rename(temporary_.c_str(), target_.c_str()) != 0) return output_error(destination_, errno_text(errno));
    release(slot_);
    temporary_.clear();
    return sync_folder(destination_, folder_of(target_));
}

Status copy_output(const std::string& from, const std::string& to) {
    auto file = OutputFile::create(to);
    if (!file) return file.error();
    const int in = ::open(from.c_str(), O_RDONLY | O_CLOEXEC);
    if (in < 0) return output_error(to, fmt::format("cannot copy {}: {}", from, errno_text(errno)));
    const int out = ::open(file->temporary_path().c_str(), O_WRONLY | O_CLOEXEC);
    int code = out < 0 ? errno : 0;
    if (code == 0 && ::ioctl(out, FICLONE, in) != 0) {
        std::vector<char> buffer(std::size_t{1} << 20);
        while (code == 0) {
            const ssize_t n = ::read(in, buffer.data(), buffer.size());
            if (n < 0 && errno != EINTR) code = errno;
            if (n == 0) break;
            for (ssize_t done = 0; code == 0 && done < n;) {
                const ssize_t written = ::write(out, buffer.data() + done, static_cast<std::size_t>(n - done));
                if (written > 0) done += written;
                if (written < 0 && errno != EINTR) code = errno;
            }
        }
    }
    ::close(in);
    if (out >= 0 && ::close(out) != 0 && code == 0) code = errno;
    if (code != 0) return output_error(to, fmt::format("cannot copy {}: {}", from, errno_text(code)));
    return file->commit();
}

Status write_text_file(const std::string& destination, std::string_view text) {
    auto file = OutputFile::create(destination);
    if (!file) return file.error();
    const int fd = ::open(file->temporary_path().c_str(), O_WRONLY | O_TRUNC | O_CLOEXEC);
    if (fd < 0) return output_error(destination, errno_text(errno));
    while (!text.empty()) {
        const ssize_t n = ::write(fd, text.data(), text.size());
        if (n < 0) {
            if (errno == EINTR) continue;
            const int code = errno;
            ::close(fd);
            return output_error(destination, errno_text(code));
        }
        text.remove_prefix(static_cast<std::size_t>(n));
    }
    if (::close(fd) != 0) return output_error(destination, errno_text(errno));
    return file->commit();
}

void remove_temporary_files_from_signal() noexcept {
    const int saved = errno;
    const pid_t process = ::getpid();
    for (Slot& slot : slots)
        if (slot.state.load() == slot_live && slot.process == process) ::unlink(slot.path);
    errno = saved;
}

}  // namespace spectex
