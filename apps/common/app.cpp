#include "app.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <signal.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <new>
#include <sstream>

#include "spectex/io.h"

namespace spectex::app {
namespace {

constexpr std::size_t help_columns = 96;
constexpr std::size_t text_column = 26;

extern "C" void on_signal(int signal) {
    const int saved = errno;
    remove_temporary_files_from_signal();
    clear_progress_line_from_signal();
    errno = saved;
    // The default action, so that the shell sees the signal itself (130 for SIGINT) and not an exit code of ours.
    ::signal(signal, SIG_DFL);
    ::raise(signal);
}

/// SIGPIPE is among them: `spxinfo FILE | head` ends as quietly as cat does, and leaves no temporary file.
void install_signal_handlers() {
    // A file beyond `ulimit -f` is then an output that failed, with its name, rather than the end of the process.
    ::signal(SIGXFSZ, SIG_IGN);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE, SIGQUIT, SIGXCPU}) {
        struct sigaction old{};
        // What the parent ignored (nohup) stays ignored.
        if (::sigaction(signal, nullptr, &old) != 0 || old.sa_handler == SIG_IGN) continue;
        struct sigaction action{};
        action.sa_handler = on_signal;
        ::sigemptyset(&action.sa_mask);
        ::sigaction(signal, &action, nullptr);
    }
}

/// Of standard input, output and error, those that the caller has closed: else the next file that is opened takes their number,
/// and reports would be written into a picture. What takes their place fails as a closed one does.
void hold_standard_descriptors() {
    for (int fd = 0; fd <= 2; ++fd)
        if (::fcntl(fd, F_GETFD) == -1 && errno == EBADF && ::open("/dev/null", fd == 0 ? O_WRONLY : O_RDONLY) != fd) ::_exit(exit_failure);
}

bool write_text(std::FILE* file, std::string_view text) {
    return std::fwrite(text.data(), 1, text.size(), file) == text.size();
}

std::string flag_heading(const Option& option) {
    std::string names;
    for (const char c : option.names) {
        names += c;
        if (c == ',') names += ' ';
    }
    return option.metavar.empty() ? names : names + " " + option.metavar;
}

std::string description(const Option& option) {
    std::vector<std::string> notes;
    if (option.required) notes.emplace_back("required");
    if (!option.range.empty()) notes.push_back("range " + option.range);
    if (!option.unit.empty()) notes.push_back("in " + option.unit);
    if (option.repeatable) notes.emplace_back("may be repeated");
    if (!option.default_value.empty()) notes.push_back("default " + option.default_value);
    return notes.empty() ? option.text : fmt::format("{} ({})", option.text, fmt::join(notes, "; "));
}

void append_entry(std::string& help, const std::string& heading, const std::string& text) {
    std::string line = "  " + heading;
    const auto lines = wrap(text, help_columns - text_column);
    std::size_t first = 0;
    if (columns(line) + 2 <= text_column) {
        line += std::string(text_column - columns(line), ' ') + lines[0];
        first = 1;
    } else {
        // A long heading breaks at its bars and spaces like any text.
        const auto parts = wrap(line.substr(2), help_columns - 4);
        line.clear();
        for (std::size_t i = 0; i < parts.size(); ++i) line += (i ? "\n    " : "  ") + parts[i];
    }
    help += line + '\n';
    for (std::size_t i = first; i < lines.size(); ++i) help += std::string(text_column, ' ') + lines[i] + '\n';
}

std::string range_text(double low, double high) {
    if (std::isinf(low) && std::isinf(high)) return {};
    if (std::isinf(high)) return "from " + number_text(low);
    if (std::isinf(low)) return "to " + number_text(high);
    return number_text(low) + ".." + number_text(high);
}

}  // namespace

int exit_code(ErrorKind kind) {
    switch (kind) {
        case ErrorKind::usage: return exit_usage;
        case ErrorKind::input:
        case ErrorKind::output:
        case ErrorKind::infeasible:
        case ErrorKind::interrupted: break;
    }
    return exit_failure;
}

App::App(AppInfo info) : info_(std::move(info)) {}

void App::group(std::string_view title) { group_ = title; }

void App::add(Option option) {
    Row row{group_, std::move(option), {}, {}};
    std::string_view rest = row.option.names;
    for (;;) {
        const auto comma = rest.find(',');
        row.names.emplace_back(rest.substr(0, comma));
        if (comma == std::string_view::npos) break;
        rest.remove_prefix(comma + 1);
    }
    rows_.push_back(std::move(row));
}

void App::flag(std::string names, bool* out, std::string text) {
    add({.names = std::move(names), .text = std::move(text), .set = [out](std::string_view) {
             *out = true;
             return Status{};
         }});
}

void App::text(std::string names, std::string metavar, std::string* out, std::string text) {
    const std::string what = metavar;
    add({.names = std::move(names), .metavar = std::move(metavar), .text = std::move(text), .default_value = *out,
         .set = [out, what](std::string_view value) -> Status {
             if (value.empty()) return expected(what, value);
             *out = value;
             return {};
         }});
}

void App::number(std::string names, std::string metavar, double* out, double low, double high, std::string unit,
                 std::string text) {
    add({.names = std::move(names), .metavar = std::move(metavar), .text = std::move(text),
         .range = range_text(low, high), .unit = std::move(unit), .default_value = number_text(*out),
         .set = [=](std::string_view value) -> Status {
             auto parsed = parse_number(value, low, high);
             if (!parsed) return parsed.error();
             *out = *parsed;
             return {};
         }});
}

void App::number(std::string names, std::string metavar, std::optional<double>* out, double low, double high,
                 std::string unit, std::string text) {
    add({.names = std::move(names), .metavar = std::move(metavar), .text = std::move(text),
         .range = range_text(low, high), .unit = std::move(unit), .default_value = *out ? number_text(**out) : "",
         .set = [=](std::string_view value) -> Status {
             auto parsed = parse_number(value, low, high);
             if (!parsed) return parsed.error();
             *out = *parsed;
             return {};
         }});
}

void App::integer(std::string names, std::string metavar, std::int64_t* out, std::int64_t low, std::int64_t high,
                  std::string text) {
    add({.names = std::move(names), .metavar = std::move(metavar), .text = std::move(text),
         .range = fmt::format("{}..{}", low, high), .default_value = std::to_string(*out),
         .set = [=](std::string_view value) -> Status {
             auto parsed = parse_integer(value, low, high);
             if (!parsed) return parsed.error();
             *out = *parsed;
             return {};
         }});
}

void App::choice(std::string names, std::string metavar, std::string* out, std::vector<std::string> choices,
                 std::string text) {
    text += fmt::format(": {}", fmt::join(choices, ", "));
    add({.names = std::move(names), .metavar = std::move(metavar), .text = std::move(text), .default_value = *out,
         .set = [out, choices = std::move(choices)](std::string_view value) -> Status {
             const std::vector<std::string_view> views(choices.begin(), choices.end());
             auto index = parse_choice(value, views);
             if (!index) return index.error();
             *out = choices[*index];
             return {};
         }});
}

void App::list(std::string names, std::string metavar, std::vector<std::string>* out, std::string text) {
    add({.names = std::move(names), .metavar = std::move(metavar), .text = std::move(text),
         .default_value = fmt::format("{}", fmt::join(*out, ",")), .set = [out](std::string_view value) -> Status {
             auto items = parse_list(value);
             if (!items) return items.error();
             *out = std::move(*items);
             return {};
         }});
}

void App::positional(std::string metavar, std::vector<std::string>* out, std::size_t least, std::size_t most,
                     std::string text) {
    positionals_.push_back({std::move(metavar), std::move(text), out, least, most});
}

void App::add_common() {
    group("Common options");
    flag("-h,--help", &help_, "print this help and exit");
    flag("--version", &version_, "print the version and exit");
    integer("--threads", "N", &threads_, 0, 1024, "number of threads; 0: all processors");
    flag("--quiet", &quiet_, "no progress bar and no notes; results and errors are still printed");
    flag("--explain", &explain_, "print what is computed, what is skipped, and why");
    add({.names = "--json", .metavar = "FILE", .text = "write the figures as JSON; -: standard output, where all other "
                                                       "text then makes way to standard error",
         .set = [this](std::string_view value) -> Status {
             if (value.empty()) return expected("FILE or -", value);
             json_path_ = value;
             return {};
         }});
    flag("--strict", &strict_, "end with 2 when pixels are NaN or infinite, instead of replacing and counting them");
}

const App::Row* App::find(std::string_view name) const {
    for (const auto& row : rows_)
        if (std::find(row.names.begin(), row.names.end(), name) != row.names.end()) return &row;
    return nullptr;
}

std::vector<std::string> App::all_names() const {
    std::vector<std::string> names;
    for (const auto& row : rows_)
        for (const auto& name : row.names)
            if (name.starts_with("--")) names.push_back(name);
    return names;
}

bool App::given(std::string_view name) const {
    const Row* row = find(name);
    return row && row->count > 0;
}

std::string App::help() const {
    std::string help;
    std::istringstream forms(info_.synopsis);
    for (std::string form; std::getline(forms, form);)
        help += fmt::format("{} {} {}\n", help.empty() ? "Usage:" : "      ", info_.name, form);
    help += '\n';
    for (const auto& line : wrap(info_.summary, help_columns)) help += line + '\n';
    if (!positionals_.empty()) {
        help += "\nArguments:\n";
        for (const auto& p : positionals_) append_entry(help, p.metavar, p.text);
    }
    std::string group;
    for (const auto& row : rows_) {
        if (row.group != group) help += fmt::format("\n{}:\n", group = row.group);
        append_entry(help, flag_heading(row.option), description(row.option));
    }
    if (!info_.examples.empty()) {
        help += "\nExamples:\n";
        for (const auto& example : info_.examples) {
            help += "  " + example.command + '\n';
            for (const auto& line : wrap(example.text, help_columns - 6)) help += "      " + line + '\n';
        }
    }
    help += "\nExit codes:\n";
    append_entry(help, "0", "all is done");
    append_entry(help, "1", "a stated threshold was exceeded");
    append_entry(help, "2", "an input or output failed");
    append_entry(help, "64", "usage: the command line is wrong, and nothing was done");
    append_entry(help, "130", "interrupted; no output is left half-written");
    return help;
}

/// Splits the command line by CLI11 into the rows' values and the other arguments, with `--` kept as a mark among these.
Result<std::vector<std::string>> App::tokenize(int argc, char** argv) {
    // CLI11 takes the argument after `--name=` for the value when that is empty, and gives flags values; both are settled
    // here by splitting at the sign. It also splits arguments in brackets where it expects several, which file names may
    // be; so it is told of no positional and hands them back as they are.
    std::vector<std::string> tokens;
    bool options = true;
    for (int i = 1; i < argc; ++i) {
        const std::string_view token = argv[i];
        if (options && token == "--") options = false;
        const auto sign = token.find('=');
        if (options && token.starts_with("--") && sign != std::string_view::npos) {
            const Row* row = find(token.substr(0, sign));
            if (row && row->option.metavar.empty())
                return Error{ErrorKind::usage, fmt::format("{} takes no value", token.substr(0, sign))};
            if (row) {
                tokens.emplace_back(token.substr(0, sign));
                tokens.emplace_back(token.substr(sign + 1));
                continue;
            }
        }
        tokens.emplace_back(token);
        if (const Row* row = options ? find(token) : nullptr; row && !row->option.metavar.empty()) {
            const std::string_view next = i + 1 < argc ? argv[i + 1] : "";
            if (i + 1 == argc) return Error{ErrorKind::usage, fmt::format("{}: expected {}", token, row->option.metavar)};
            if (find(next))
                return Error{ErrorKind::usage, fmt::format("{}: expected {}, but the option {} follows", token,
                                                           row->option.metavar, next)};
            tokens.emplace_back(next);
            ++i;
        }
    }

    CLI::App cli;
    cli.set_help_flag();
    cli.allow_extras();
    std::vector<CLI::Option*> parsers;
    for (const auto& row : rows_) {
        // CLI11 wants a callback; values are read from the option afterwards, unconverted.
        CLI::Option* parser =
            row.option.metavar.empty()
                ? cli.add_flag(row.option.names)
                : cli.add_option(row.option.names, CLI::callback_t([](const CLI::results_t&) { return true; }));
        parsers.push_back(parser->multi_option_policy(CLI::MultiOptionPolicy::TakeAll));
    }
    std::reverse(tokens.begin(), tokens.end());
    try {
        cli.parse(tokens);
    } catch (const CLI::Error& error) {
        return Error{ErrorKind::usage, error.what()};
    }
    for (std::size_t i = 0; i < rows_.size(); ++i) {
        rows_[i].count = parsers[i]->count();
        if (!rows_[i].option.metavar.empty()) rows_[i].values = parsers[i]->results();
    }
    return cli.remaining();
}

Status App::assign_positionals(std::vector<std::string> arguments) {
    std::size_t reserved = 0;
    for (const auto& p : positionals_) reserved += p.least;
    auto next = arguments.begin();
    for (const auto& p : positionals_) {
        const auto left = static_cast<std::size_t>(arguments.end() - next);
        reserved -= p.least;
        const std::size_t take = std::min(p.most, left > reserved ? left - reserved : 0);
        if (take < p.least)
            return Error{ErrorKind::usage, p.least == 1 && p.most > 1 ? fmt::format("{}: expected at least one", p.metavar)
                                                                     : fmt::format("{}: missing", p.metavar)};
        p.out->assign(std::make_move_iterator(next), std::make_move_iterator(next + static_cast<std::ptrdiff_t>(take)));
        next += static_cast<std::ptrdiff_t>(take);
    }
    if (next != arguments.end()) return Error{ErrorKind::usage, fmt::format("unexpected argument '{}'", next->substr(0, 120))};
    return {};
}

std::optional<int> App::parse(int argc, char** argv) {
    add_common();
    auto remaining = tokenize(argc, argv);
    // Help and version are given even where the rest of the line is wrong.
    for (int i = 1; i < argc && std::string_view(argv[i]) != "--"; ++i) {
        const std::string_view token = argv[i];
        if (token != "-h" && token != "--help" && token != "--version") continue;
        const bool version_asked = token == "--version";
        const bool ok = write_text(stdout, version_asked ? fmt::format("{} {}\n", info_.name, version()) : help()) &&
                        std::fflush(stdout) == 0;
        return ok ? exit_ok : exit_failure;
    }
    if (!remaining) return usage_error(remaining.error().message);

    std::vector<std::string> arguments;
    bool options = true;
    for (auto& argument : *remaining) {
        if (options && argument == "--") {
            options = false;
        } else if (options && argument.size() > 1 && argument[0] == '-') {
            const std::string name = argument.substr(0, argument.find('='));
            const auto near = nearest(name, all_names());
            return usage_error(fmt::format("unknown option {}{}", name.substr(0, 120),
                                           near ? fmt::format(", did you mean {}?", *near) : ""));
        } else {
            arguments.push_back(std::move(argument));
        }
    }
    for (auto& row : rows_) {
        if (row.count > 1 && !row.option.repeatable)
            return usage_error(fmt::format("{} is given {} times, expected once", row.names.back(), row.count));
        if (row.option.metavar.empty() && row.count > 0) row.values = {""};
        for (const auto& value : row.values)
            if (auto set = row.option.set(value); !set)
                return report({set.error().kind, fmt::format("{}: {}", row.names.back(), set.error().message)});
    }
    const std::array<NamedOutput, 1> json{{{"--json", json_path_}}};
    if (auto checked = check_outputs({}, json); !checked) return report(checked.error());
    if (auto assigned = assign_positionals(std::move(arguments)); !assigned) return report(assigned.error());
    for (const auto& row : rows_)
        if (row.option.required && row.count == 0)
            return usage_error(fmt::format("{}: expected {}, got nothing", row.names.back(), row.option.metavar));
    return std::nullopt;
}

int App::run(int argc, char** argv, const std::function<int()>& body) {
    hold_standard_descriptors();
    install_signal_handlers();
    try {
        if (const auto code = parse(argc, argv)) return *code;
        int code = exit_failure;
        try {
            code = body();
        } catch (const std::bad_alloc&) {
            code = report({ErrorKind::input, "out of memory"});
        }
        return finish(code);
    } catch (const std::exception& error) {
        return report({ErrorKind::input, fmt::format("unexpected: {}", error.what())});
    }
}

Result<std::vector<std::string>> App::inputs(std::span<const std::string> arguments) {
    auto files = expand_inputs(arguments);
    if (!files) return files;
    const std::array<NamedOutput, 1> json{{{"--json", json_path_}}};
    if (auto checked = check_outputs(*files, json); !checked) return checked.error();
    return files;
}

int App::each(std::span<const Job> jobs, const std::function<Result<Json>(const Job&)>& work) {
    many_ = jobs.size() > 1;
    int worst = exit_ok;
    for (const auto& job : jobs) {
        auto object = work(job);
        if (object) {
            Json named = {{"input", job.input}};
            named.update(*object);
            record(std::move(named));
        } else {
            worst = std::max(worst, report(object.error(), job.input));
            record({{"input", job.input}, {"error", object.error().message}});
        }
    }
    return worst;
}

namespace {

/// Every text that is `from` becomes `to`.
void rename_texts(Json& json, const std::string& from, const std::string& to) {
    if (json.is_string() && json.get_ref<const std::string&>() == from) json = to;
    if (json.is_structured())
        for (auto& item : json) rename_texts(item, from, to);
}

}  // namespace

int App::each_distinct(std::span<const Job> jobs, const std::function<Result<Json>(const Job&)>& work) {
    struct Made {
        const Job* job;
        Json json;
    };
    std::map<std::pair<std::size_t, int>, Made> made;  // by content and level
    EqualFiles contents;
    return each(jobs, [&](const Job& job) -> Result<Json> {
        // A single input has no other to be equal to, and is not read for it.
        const auto content = jobs.size() > 1 ? contents.number(job.input) : std::nullopt;
        const auto earlier = content ? made.find({*content, job.mip}) : made.end();
        if (earlier == made.end()) {
            auto json = work(job);
            if (json && content) made.insert({{*content, job.mip}, {&job, *json}});
            return json;
        }
        const Job& first = *earlier->second.job;
        Json json = earlier->second.json;
        const std::pair<std::string, std::string> rows[] = {
            {"input", fmt::format("the bytes of {}", first.input)},
            {"skipped", fmt::format("reading, converting and writing it: {} is copied", fmt::join(first.outputs, ", "))}};
        explain(job.input, rows);
        for (std::size_t i = 0; i < job.outputs.size(); ++i) {
            if (auto copied = copy_output(first.outputs[i], job.outputs[i]); !copied) return copied.error();
            note(fmt::format("{}: copied from {}, whose input has the same bytes", job.outputs[i], first.outputs[i]));
            rename_texts(json, first.outputs[i], job.outputs[i]);
        }
        rename_texts(json, first.input, job.input);
        json["copied_from"] = first.outputs[0];
        return json;
    });
}

int App::report(const Error& error, std::string_view file) {
    clear_progress_line();
    std::fflush(stdout);
    std::string text = info_.name + ": ";
    if (!file.empty() && error.message.find(file) == std::string::npos) text += escape(file) + ": ";
    text += escape(error.message) + '\n';
    write_text(stderr, text);
    last_error_ = error.message;
    return exit_code(error.kind);
}

int App::usage_error(std::string_view message) { return report({ErrorKind::usage, std::string(message)}); }

void App::warn(std::string_view message) {
    clear_progress_line();
    write_text(stderr, fmt::format("{}: warning: {}\n", info_.name, escape(message)));
}

void App::note(std::string_view message) {
    if (quiet_) return;
    clear_progress_line();
    write_text(stderr, escape(message) + '\n');
}

void App::out(std::string_view text) {
    clear_progress_line();
    if (!write_text(json_path_ == "-" ? stderr : stdout, text)) text_failed_ = true;
}

void App::table(std::string_view title, std::span<const std::pair<std::string, std::string>> rows) {
    std::size_t width = 0;
    for (const auto& row : rows) width = std::max(width, columns(row.first));
    std::string text;
    if (!title.empty()) text += escape(title) + '\n';
    for (const auto& [key, value] : rows)
        text += fmt::format("  {}{} {}\n", key, std::string(width - columns(key) + 1, ' '), escape(value));
    out(text);
}

void App::explain(std::string_view title, std::span<const std::pair<std::string, std::string>> rows) {
    if (explain_) table(title, rows);
}

void App::record(Json object) {
    if (wants_json()) records_.push_back(std::move(object));
}

Progress App::progress(std::string_view label) const { return {label, !quiet_ && ::isatty(STDERR_FILENO) == 1}; }

int App::finish(int code) {
    // A wrong request writes nothing, JSON included.
    if (wants_json() && code != exit_usage) {
        if (records_.empty()) records_.push_back(last_error_.empty() ? Json::object() : Json{{"error", last_error_}});
        const Json document = many_ || records_.size() > 1 ? Json(records_) : records_.front();
        const std::string text = document.dump(2, ' ', false, Json::error_handler_t::replace) + '\n';
        if (json_path_ == "-") {
            if (!write_text(stdout, text)) text_failed_ = true;
        } else if (auto written = write_text_file(json_path_, text); !written) {
            code = std::max(code, report(written.error(), json_path_));
        }
    }
    if (std::fflush(stdout) != 0 || text_failed_)
        code = std::max<int>(code, report({ErrorKind::output, fmt::format("cannot write standard output: {}", std::strerror(errno))}));
    return code;
}

}  // namespace spectex::app
