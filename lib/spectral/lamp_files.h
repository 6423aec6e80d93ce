// Files that hold the power of a light, one function per format. Text is hostile: rows are counted before they are kept.
#pragma once

#include <string>
#include <string_view>

#include "spectex/spectral.h"

namespace spectex {

/// Beyond these a file is no lamp's: 8 MiB of text, 100000 rows.
inline constexpr std::size_t most_lamp_bytes = std::size_t{8} << 20;
inline constexpr std::size_t most_lamp_rows = 100000;

/// What a lamp's file says, in nm and relative power.
struct LampFile {
    SpectralDistribution power;
    std::string format;  ///< for people: "two columns", "CGATS spectrum", ...
};

/// A lamp's file of any of the formats below, told by its content and, for pbrt's, by the suffix of `label`.
/// @error input: no format, or a value out of order, negative, not finite, or not where anyone sees; names `label` and the
/// line.
Result<LampFile> parse_lamp_file(std::string_view text, std::string_view label);

/// Two columns: wavelength and relative power. Comments begin with #, ; or //; fields are parted by commas, semicolons or
/// blanks; one line of column names may come first.
Result<LampFile> parse_columns(std::string_view text, std::string_view label);
/// pbrt's named spectra (.spd): pairs of wavelength in nm and power, parted by blanks, any number on a line; # comments.
Result<LampFile> parse_pbrt_spd(std::string_view text, std::string_view label);
/// One spectrum in CGATS.17 text, as ArgyllCMS writes it (.sp): SPECTRAL_BANDS, SPECTRAL_START_NM, SPECTRAL_END_NM and
/// SPECTRAL_NORM with a block of data; or fields whose names end in their wavelength (SPEC_380, nm380, SPECTRAL_NM_380).
Result<LampFile> parse_cgats(std::string_view text, std::string_view label);
/// IES TM-27-14 (.spdx): XML with SpectralData elements; WavelengthUnits, where given, in nm, µm, Å or m. Reflectances and
/// transmittances are refused. No entity of the document is ever expanded.
Result<LampFile> parse_tm27(std::string_view text, std::string_view label);

}  // namespace spectex
