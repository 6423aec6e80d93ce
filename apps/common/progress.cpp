#include "progress.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <mutex>
#include <string>

#include "text.h"

namespace spectex::app {
namespace {

using Clock = std::chrono::steady_clock;

std::atomic<bool> line_drawn{false};
static_assert(std::atomic<bool>::is_always_lock_free, "read from a signal handler");

void write_stderr(std::string_view text) noexcept {
    while (!text.empty()) {
        const auto n = ::write(STDERR_FILENO, text.data(), text.size());
        if (n <= 0) return;
        text.remove_prefix(static_cast<std::size_t>(n));
    }
}

std::size_t terminal_columns() {
    winsize size{};
    if (::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0) return 80;
    return size.ws_col;
}

std::string duration_text(double seconds) {
    const auto s = static_cast<long long>(std::min(seconds, 359999.0) + 0.5);
    return s >= 3600 ? fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60) : fmt::format("{}:{:02}", s / 60, s % 60);
}

}  // namespace

struct Progress::State {
    std::string label;
    Clock::time_point start = Clock::now(), drawn{};
    std::mutex mutex;

    void draw(std::uint64_t done, std::uint64_t total) {
        const std::lock_guard lock(mutex);
        const auto now = Clock::now();
        if (now - drawn < std::chrono::milliseconds(100) || total == 0) return;
        drawn = now;
        const double seconds = std::chrono::duration<double>(now - start).count();
        const double fraction = std::min(1.0, static_cast<double>(done) / static_cast<double>(total));
        const double rate = seconds > 0 ? static_cast<double>(done) / seconds : 0;
        const std::string figures =
            fmt::format(" {:3.0f}% {:.1f} Mpixel/s, {} left", 100 * fraction, rate / 1e6,
                        rate > 0 && done <= total ? duration_text(static_cast<double>(total - done) / rate) : "?");
        const std::size_t room = terminal_columns();
        // The last column stays free: some terminals wrap when it is written.
        const std::size_t used = columns(label) + 1 + figures.size() + 3;
        std::string line = "\r\033[K";
        if (used + 8 <= room) {
            const std::size_t width = std::min<std::size_t>(40, room - used);
            const auto full = static_cast<std::size_t>(fraction * static_cast<double>(width));
            line += fmt::format("{} [{:<{}}]{}", label, std::string(full, '#'), width, figures);
        } else if (figures.size() < room) {
            line += figures.substr(1);
        }
        line_drawn = true;
        write_stderr(line);
    }
};

Progress::Progress(std::string_view label, bool enabled) {
    if (!enabled) return;
    state_ = std::make_unique<State>();
    this->label(label);
}

void Progress::label(std::string_view label) const {
    if (!state_) return;
    std::string text = escape(label);
    if (columns(text) > 30) {
        // Cut at the front, where long paths agree, and only before a code point.
        std::size_t at = text.size() - 29;
        while (at < text.size() && (static_cast<unsigned char>(text[at]) & 0xC0) == 0x80) ++at;
        text = "…" + text.substr(at);
    }
    const std::lock_guard lock(state_->mutex);
    state_->label = std::move(text);
}

Progress::~Progress() {
    if (state_) clear_progress_line();
}

Progress::Progress(Progress&&) noexcept = default;

void Progress::operator()(std::uint64_t done, std::uint64_t total) const {
    if (state_) state_->draw(done, total);
}

ProgressFunction Progress::function() const {
    if (!state_) return [](std::uint64_t, std::uint64_t) {};
    return [state = state_.get()](std::uint64_t done, std::uint64_t total) { state->draw(done, total); };
}

void clear_progress_line() {
    if (line_drawn.exchange(false)) write_stderr("\r\033[K");
}

void clear_progress_line_from_signal() noexcept {
    if (line_drawn.load()) write_stderr("\r\033[K");
}

}  // namespace spectex::app
