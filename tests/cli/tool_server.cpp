// Preloaded into a tool, runs its main() as often as asked, each time in a process of its own that is forked when every library
// is loaded. Loading those that OpenImageIO needs (more than two hundred) takes most of the time of a short run.
//
// A request on the socket SPECTEX_TOOL_SERVER: the count of bytes that follow, with standard input, output and error beside it;
// then folder, count of arguments, arguments (the first is the tool), environment, each ended by a zero byte. Answers: the
// process id, then the status as waitpid gives it. Numbers are 32 bits in this machine's order.
#include <dlfcn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <string>
#include <vector>

namespace {

using Main = int (*)(int, char**, char**);
Main tool_main = nullptr;

[[noreturn]] void leave(int code) { ::_exit(code); }

bool read_all(int fd, char* out, std::size_t count) {
    while (count > 0) {
        const auto got = ::read(fd, out, count);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) return false;
        out += got;
        count -= static_cast<std::size_t>(got);
    }
    return true;
}

void answer(int fd, std::int32_t number) {
    if (::send(fd, &number, sizeof number, MSG_NOSIGNAL) != static_cast<ssize_t>(sizeof number)) leave(1);
}

int serve(int argc, char** argv, char** environment) {
    const char* const named = std::getenv("SPECTEX_TOOL_SERVER");
    if (!named) return tool_main(argc, argv, environment);
    const int server = std::atoi(named);
    for (;;) {
        std::uint32_t bytes = 0;
        std::array<int, 3> standard{};
        iovec vector{&bytes, sizeof bytes};
        alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof standard)> control{};
        msghdr message{};
        message.msg_iov = &vector;
        message.msg_iovlen = 1;
        message.msg_control = control.data();
        message.msg_controllen = control.size();
        const auto got = ::recvmsg(server, &message, MSG_WAITALL);
        if (got < 0 && errno == EINTR) continue;
        if (got == 0) leave(0);  // nobody asks any more
        const cmsghdr* const beside = CMSG_FIRSTHDR(&message);
        if (got != static_cast<ssize_t>(sizeof bytes) || !beside || beside->cmsg_len != CMSG_LEN(sizeof standard)) leave(1);
        std::memcpy(standard.data(), CMSG_DATA(beside), sizeof standard);
        std::string text(bytes, '\0');
        if (!read_all(server, text.data(), bytes)) leave(1);

        const pid_t child = ::fork();
        if (child < 0) leave(1);
        if (child > 0) {
            for (const int fd : standard) ::close(fd);
            answer(server, child);
            int status = 0;
            while (::waitpid(child, &status, 0) < 0)
                if (errno != EINTR) leave(1);
            answer(server, status);
            continue;
        }
        ::close(server);
        for (int fd = 0; fd < 3; ++fd)
            if (::dup2(standard[static_cast<std::size_t>(fd)], fd) < 0) leave(127);
        for (const int fd : standard)
            if (fd > 2) ::close(fd);
        std::vector<char*> parts;
        for (std::size_t at = 0; at < text.size(); at += std::strlen(&text[at]) + 1) parts.push_back(&text[at]);
        if (parts.size() < 3 || ::chdir(parts[0]) != 0) leave(127);
        const int count = std::atoi(parts[1]);
        std::vector<char*> arguments(parts.begin() + 2, parts.begin() + 2 + count), variables(parts.begin() + 2 + count, parts.end());
        arguments.push_back(nullptr);
        variables.push_back(nullptr);
        environ = variables.data();
        const int code = tool_main(count, arguments.data(), environ);
        std::cout.flush();
        std::fflush(nullptr);
        // Some library's threads were begun while it was loaded and are not in this process: its last act would wait for them.
        leave(code);
    }
}

}  // namespace

// What the C runtime of an executable calls with its main().
extern "C" __attribute__((visibility("default"))) int __libc_start_main(Main main, int argc, char** argv, void (*init)(), void (*fini)(),
                                                                        void (*loader_fini)(), void* stack_end) {
    using Start = int (*)(Main, int, char**, void (*)(), void (*)(), void (*)(), void*);
    const auto start = reinterpret_cast<Start>(::dlsym(RTLD_NEXT, "__libc_start_main"));
    tool_main = main;
    return start(serve, argc, argv, init, fini, loader_fini, stack_end);
}
