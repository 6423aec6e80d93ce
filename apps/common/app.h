// What every command-line tool shares: one table of options that makes the parser and the help, exit codes, messages, JSON,
// signals.
//
// A tool's main fills the table and hands over its body; usage errors end with 64 before the body runs. Option handlers run
// in the table's order, whatever order was typed. Text from outside (file names, arguments) is escaped on its way to the
// terminal and is never a format string.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "files.h"
#include "progress.h"
#include "spectex/base.h"
#include "text.h"

namespace spectex::app {

using Json = nlohmann::ordered_json;

enum ExitCode : int {
    exit_ok = 0,
    exit_threshold = 1,  ///< a stated threshold was exceeded
    exit_failure = 2,    ///< an input or output failed
    exit_usage = 64,
};

int exit_code(ErrorKind kind);

/// One row of the table.
struct Option {
    std::string names{};         ///< "-o,--output"
    std::string metavar{};       ///< "FILE"; empty for a flag
    std::string text{};          ///< one line for the help
    std::string range{};         ///< "0..1024", or empty
    std::string unit{};          ///< "nm", or empty
    std::string default_value{}; ///< as shown, or empty
    bool required = false;
    bool repeatable = false;    ///< otherwise a second occurrence is an error
    /// Takes a value, or "" for a flag. The message need not name the option.
    std::function<Status(std::string_view)> set{};
};

struct Example {
    std::string command, text;
};

struct AppInfo {
    std::string name;      ///< spxuplift
    std::string synopsis;  ///< "IN... -o OUT [options]"; several forms, a line each
    std::string summary;
    std::vector<Example> examples;
};

class App {
public:
    explicit App(AppInfo info);
    App(const App&) = delete;
    App& operator=(const App&) = delete;

    /// Options added from here on stand under this heading.
    void group(std::string_view title);
    void add(Option option);

    void flag(std::string names, bool* out, std::string text);
    void text(std::string names, std::string metavar, std::string* out, std::string text);
    /// Inclusive range; infinite ends are open.
    void number(std::string names, std::string metavar, double* out, double low, double high, std::string unit,
                std::string text);
    void number(std::string names, std::string metavar, std::optional<double>* out, double low, double high,
                std::string unit, std::string text);
    void integer(std::string names, std::string metavar, std::int64_t* out, std::int64_t low, std::int64_t high,
                 std::string text);
    void choice(std::string names, std::string metavar, std::string* out, std::vector<std::string> choices,
                std::string text);
    void list(std::string names, std::string metavar, std::vector<std::string>* out, std::string text);

    static constexpr std::size_t unlimited = std::numeric_limits<std::size_t>::max();
    /// Arguments that are not options, in order; each takes as many as leave the later ones their least.
    void positional(std::string metavar, std::vector<std::string>* out, std::size_t least, std::size_t most,
                    std::string text);

    /// Set by tests of command lines: a tool then ends, with 0, where work would begin that needs no input file, and which may
    /// take hours.
    inline static bool lines_only = false;

    /// Parses, runs the body, writes the JSON, and gives the exit code. No exception passes.
    int run(int argc, char** argv, const std::function<int()>& body);

    /// Whether an option was typed, by any of its names.
    bool given(std::string_view name) const;
    const std::string& name() const { return info_.name; }
    int threads() const { return static_cast<int>(threads_); }  ///< 0: all processors
    bool quiet() const { return quiet_; }
    bool explaining() const { return explain_; }
    bool strict() const { return strict_; }

    /// Expands file arguments (see files.h); more than one makes the JSON an array. Refuses a --json FILE that is an input.
    Result<std::vector<std::string>> inputs(std::span<const std::string> arguments);

    /// Runs `work` on each item; what fails is reported, recorded and passed over. `work` gives the item's JSON, to which
    /// `input` is added unless it has one. Returns the worst exit code.
    int each(std::span<const Job> jobs, const std::function<Result<Json>(const Job&)>& work);
    /// The same, for work that depends on the input's bytes and level alone: where an earlier input has the same ones, its
    /// outputs are copied and its JSON repeated with the names of this job and `copied_from`.
    int each_distinct(std::span<const Job> jobs, const std::function<Result<Json>(const Job&)>& work);

    /// Prints `TOOL: message`, or `TOOL: FILE: message` when the message does not name the file; gives the exit code.
    int report(const Error& error, std::string_view file = {});
    int usage_error(std::string_view message);
    /// `TOOL: warning: message`, also with --quiet.
    void warn(std::string_view message);
    /// What was done, for people; nothing with --quiet. Standard error.
    void note(std::string_view message);
    /// A result, as it is: to standard output, or to standard error when that belongs to the JSON.
    void out(std::string_view text);
    /// Aligned key and value lines under a title, when --explain was given. Keys may repeat; values are escaped.
    void explain(std::string_view title, std::span<const std::pair<std::string, std::string>> rows);
    /// The same unconditionally, for results.
    void table(std::string_view title, std::span<const std::pair<std::string, std::string>> rows);

    /// Adds an object to the JSON output. Non-finite numbers become null, invalid UTF-8 the replacement character.
    void record(Json object);
    /// Whether --json was given: costly figures may depend on it.
    bool wants_json() const { return !json_path_.empty(); }
    /// For check_outputs: empty without --json, `-` for standard output.
    const std::string& json_path() const { return json_path_; }

    /// A bar on a terminal; nothing in a pipe or with --quiet.
    Progress progress(std::string_view label) const;

    std::string help() const;

private:
    struct Positional {
        std::string metavar, text;
        std::vector<std::string>* out;
        std::size_t least, most;
    };
    struct Row {
        std::string group;
        Option option;
        std::vector<std::string> names{};
        std::vector<std::string> values{};
        std::size_t count = 0;
    };

    void add_common();
    Result<std::vector<std::string>> tokenize(int argc, char** argv);
    Status assign_positionals(std::vector<std::string> arguments);
    std::optional<int> parse(int argc, char** argv);
    int finish(int code);
    const Row* find(std::string_view name) const;
    std::vector<std::string> all_names() const;

    AppInfo info_;
    std::string group_ = "Options";
    std::vector<Row> rows_;
    std::vector<Positional> positionals_;
    std::int64_t threads_ = 0;
    bool quiet_ = false, explain_ = false, strict_ = false, help_ = false, version_ = false;
    std::string json_path_;
    std::vector<Json> records_;
    bool many_ = false;
    std::string last_error_;
    bool text_failed_ = false;
};

}  // namespace spectex::app
