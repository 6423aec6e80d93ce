// What a method hands to the registry, and the JSON that all models share.
#pragma once

#include <nlohmann/json.hpp>
#include <span>

#include "spectex/methods.h"
#include "spectex/solvers.h"

namespace spectex::registry {

using Json = nlohmann::ordered_json;
using ModelResult = Result<std::shared_ptr<const Model>>;

/// One row of the table in registry.cpp.
struct Entry {
    MethodInfo info;
    ModelResult (*make)(const MethodInfo& info, const Colorimetry& colorimetry);
    /// @param json  the whole object; its Colorimetry has been read already.
    ModelResult (*from_json)(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json);
    /// The same as make, learnt from these sets; null where nothing is learnt.
    ModelResult (*train)(const MethodInfo& info, const Colorimetry& colorimetry, std::span<const SampleSet> sets) = nullptr;
};

Entry mallett2019();
Entry mallett2019_published();
Entry lattice();
Entry smits1999();
Entry smits1999_exact();
Entry jakob2019();
Entry jakob2019_table();
Entry macadam1935();
Entry burns2020();
Entry meng2015();
Entry meng2015_matched();
Entry otsu2018();
Entry peters2019();
Entry peters2019_fourier();

/// The members that every model starts with: format, method, bands, observer, illuminant, rgb_space, matrix. An illuminant
/// that its name does not bring back (a file, a mixture) carries its power.
Json model_json(const Model& model);

/// A member that is a list of numbers.
/// @error input, naming the member, unless it holds `count` finite numbers in [low, high].
Result<std::vector<double>> read_numbers(const Json& json, std::string_view member, std::size_t count, double low, double high);
/// A member that is a text of at most 256 bytes. @error input, naming the member.
Result<std::string> read_text(const Json& json, std::string_view member);

}  // namespace spectex::registry
