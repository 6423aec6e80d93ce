// How spxbench hands over what it measured.
#pragma once

#include <string>
#include <vector>

#include "../common/app.h"

namespace spectex::bench {

/// A table as Markdown, for people and for a README, and as CSV.
class Table {
public:
    explicit Table(std::vector<std::string> header) : rows_{std::move(header)} {}
    void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
    std::string markdown() const;
    std::string csv() const;

private:
    std::vector<std::vector<std::string>> rows_;
};

/// Makes the folder where there is none; an empty name is no folder. @error output.
Status make_folder(const std::string& folder);

/// Prints the table, and keeps table (.md, .csv) and figures (.json) in the folder under `name`. @return the exit code.
int deliver(app::App& tool, const std::string& folder, const std::string& name, const Table& table, app::Json json);

}  // namespace spectex::bench
