// A progress bar on a terminal.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string_view>

namespace spectex::app {

/// Called by the library with pixels done and in all; may be called from any thread.
using ProgressFunction = std::function<void(std::uint64_t done, std::uint64_t total)>;

/// Draws a bar on standard error with percentage, Mpixel/s and remaining time, at most ten times a second, and clears it
/// when destroyed. One at a time.
class Progress {
public:
    /// @param enabled  false: nothing is ever drawn (not a terminal, --quiet).
    Progress(std::string_view label, bool enabled);
    ~Progress();
    Progress(Progress&&) noexcept;
    Progress& operator=(Progress&&) = delete;
    void operator()(std::uint64_t done, std::uint64_t total) const;
    /// Another label from here on. Any thread may call it.
    void label(std::string_view text) const;
    /// Valid while this object lives.
    ProgressFunction function() const;

private:
    struct State;
    std::unique_ptr<State> state_;
};

/// Wipes the bar so that a message can take its line; the next step draws it again.
void clear_progress_line();
/// The same from a signal handler.
void clear_progress_line_from_signal() noexcept;

}  // namespace spectex::app
