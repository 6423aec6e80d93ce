// Spectra, observers, illuminants, RGB spaces, and the one quadrature that joins them.
//
// Wavelengths are in nanometres, in air as the tables are, strictly ascending. Reflectances are dimensionless; spectral
// power distributions are relative unless said otherwise. Everything is computed in double. Objects are immutable once
// made and may be read from any number of threads.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"

namespace spectex {

/// Evenly spaced wavelengths start, start + step, ..., end, in nm.
class SPECTEX_API SpectralShape {
public:
    /// @error usage, unless 0 < start <= end, step > 0, all finite, and step divides end - start (to 1e-6 of a step).
    static Result<SpectralShape> make(double start_nm, double end_nm, double step_nm);

    double start_nm() const { return start_nm_; }
    double end_nm() const { return end_nm_; }
    double step_nm() const { return step_nm_; }
    std::size_t size() const { return size_; }
    double wavelength_nm(std::size_t i) const { return start_nm_ + step_nm_ * static_cast<double>(i); }

private:
    double start_nm_ = 380, end_nm_ = 780, step_nm_ = 5;
    std::size_t size_ = 81;
};

/// Centres of the bands in which a spectrum is stored or solved, in nm, strictly ascending, at least three. Between
/// centres a spectrum is linear; outside [front, back] it is zero.
class SPECTEX_API BandSet {
public:
    static constexpr std::size_t max_size = 4096;

    /// The library's own grid: 380 to 780 nm by 5 nm.
    BandSet();
    explicit BandSet(const SpectralShape& shape);
    /// @error input, when the list is not finite, positive, strictly ascending, or of 3 to max_size entries.
    static Result<BandSet> make(std::vector<double> wavelengths_nm);
    /// `START:END:STEP` in nm; `N` bands evenly over 380..780 nm (for N below 19 over the widest part of it on which the
    /// primaries of mallett2019 exist), rounded to the 1e-6 nm that channel names keep;
    /// `auto`, 380:780:10. @error usage, naming what was expected.
    static Result<BandSet> parse(std::string_view text);

    std::size_t size() const { return wavelengths_nm_.size(); }
    double operator[](std::size_t i) const { return wavelengths_nm_[i]; }
    double front() const { return wavelengths_nm_.front(); }
    double back() const { return wavelengths_nm_.back(); }
    const std::vector<double>& wavelengths_nm() const { return wavelengths_nm_; }
    /// The step in nm when the centres are evenly spaced (to 1e-6 nm).
    std::optional<double> uniform_step_nm() const;
    /// `380:780:5`, or `7 bands, 400..700 nm` when uneven.
    std::string describe() const;
    bool operator==(const BandSet&) const = default;

private:
    std::vector<double> wavelengths_nm_;
};

enum class Interpolation {
    linear,   ///< between neighbours; what CIE 15 says of D65 and of lamps at 5 nm
    sprague,  ///< fifth order through six points, evenly spaced smooth data (CIE 167:2005, eq. 1 and 2)
    cubic,    ///< natural cubic spline, any spacing
};
enum class Extrapolation {
    zero,  ///< nothing outside: emission
    hold,  ///< the end values: reflectance
};

/// A tabulated function of wavelength: a reflectance, a colour matching function, or relative spectral power.
class SPECTEX_API SpectralDistribution {
public:
    SpectralDistribution() = default;
    /// @error input, unless both lists have one length >= 1, all is finite, and wavelengths ascend strictly.
    static Result<SpectralDistribution> make(std::vector<double> wavelengths_nm, std::vector<double> values);

    const std::vector<double>& wavelengths_nm() const { return wavelengths_nm_; }
    const std::vector<double>& values() const { return values_; }
    std::size_t size() const { return values_.size(); }

    /// Value at a wavelength by linear interpolation.
    double at(double wavelength_nm, Extrapolation outside) const;
    /// Values at other wavelengths. Sprague falls back to cubic for uneven or fewer than six points.
    std::vector<double> resampled(std::span<const double> wavelengths_nm, Interpolation between,
                                  Extrapolation outside) const;

private:
    std::vector<double> wavelengths_nm_;
    std::vector<double> values_;
};

/// Colour matching functions of a standard observer at 1 nm.
struct Observer {
    std::string id;     ///< cie1931, cie1964, cie2006-2, cie2006-10
    std::string title;  ///< for people: "CIE 1931 2°"
    double start_nm = 360;
    std::vector<double> x_bar, y_bar, z_bar;  ///< one entry per nm from start_nm
};

/// The observer of that id, or an alias (`1931`, `2`, `1964`, `10`, `2006-2`, `2015-10`, ...).
/// @error usage, listing the ids.
SPECTEX_API Result<std::shared_ptr<const Observer>> find_observer(std::string_view name);
SPECTEX_API std::vector<std::string> observer_ids();

/// A light source as a relative spectral power distribution.
struct Illuminant {
    std::string name;   ///< canonical: D65, FL11, D:5003, P:2856, or the stem of a file
    std::string title;  ///< for people
    SpectralDistribution power;
};

/// An illuminant from its specification: a name (A B C D50 D55 D60 D65 D75 D93 E F1..F12 FL1..FL12 FL3.1..FL3.15
/// HP1..HP5), a lamp of the table by `lamp:INDEX` or label, `D:CCT` (daylight, 4000..25000 K), `P:CCT` (Planck),
/// a file (two columns of .csv or .txt, CGATS .sp, pbrt .spd, IES TM-27-14 .spdx), or a weighted mixture `0.7*A+0.3*FL11` (each normalised to equal luminance of
/// CIE 1931 first).
/// Sources: CIE 15:2018 eq. 3.1 (A), 4.3..4.6 (daylight); Planck's law with c2 of CODATA 2018.
/// @error usage for an unknown name or a temperature out of range; input for a file, naming the line.
SPECTEX_API Result<Illuminant> parse_illuminant(std::string_view specification);

/// A row of the list of illuminants that can be named.
struct IlluminantEntry {
    std::string name, title, kind;
};
/// Every named illuminant and every lamp, in a stable order.
SPECTEX_API Result<std::vector<IlluminantEntry>> list_illuminants();

/// Chromaticities that define an additive RGB space. Encodings (transfer curves) are the colour room's concern.
struct RgbSpace {
    std::string name;                                     ///< BT.709, Display P3, ...
    std::array<std::array<double, 2>, 3> primaries_xy{};  ///< of R, G, B
    std::array<double, 2> white_xy{};                     ///< as the defining document rounds it
    std::string illuminant;                               ///< the illuminant whose white it is: D65, D60, D50
    std::string source;                                   ///< the defining document
};

/// BT.709 (sRGB), Display P3, Adobe RGB, Rec.2020, ACEScg (AP1), ACES2065-1 (AP0), ProPhoto, PAL/SECAM; spelled with any
/// case, spaces, dots, dashes. @error usage, listing the names.
SPECTEX_API Result<RgbSpace> find_rgb_space(std::string_view name);
SPECTEX_API const std::vector<RgbSpace>& rgb_spaces();

/// Matrix from linear RGB to XYZ for primaries and a white, so that (1,1,1) maps to the white with its own Y.
/// Source: SMPTE RP 177-1993, section 3.
SPECTEX_API Matrix3 rgb_to_xyz_matrix(const RgbSpace& space, const Vector3& white_xyz);
/// XYZ of a chromaticity at Y = 1.
SPECTEX_API Vector3 xyz_from_xy(double x, double y);

/// Tristimulus weights of a light and an observer on a band set: with them XYZ = W r for a reflectance r stored in the bands.
struct TristimulusWeights {
    std::vector<double> w;  ///< [3][bands], row-major: X, Y, Z
    Vector3 white{};        ///< W 1: the tristimulus of the perfect reflecting diffuser inside the stored range
};

enum class Normalization {
    luminance,  ///< scaled so that the perfect diffuser has Y = 1
    none,       ///< scaled so that CIE D65 (100 at 560 nm) would have Y = 1: lamps keep their relative power
};

/// The quadrature: every integral against an observer goes through it. Sums S(l) x_bar(l) h_b(l) over whole nanometres l
/// in [front, back], with h_b the bands' linear interpolation kernel (the idea of ASTM E2022), never samples at band
/// centres. A table finer than 1 nm is first averaged with a 2 nm triangle. Compensated sums.
/// @error input, when the light has no power in the range (normalisation would divide by zero).
SPECTEX_API Result<TristimulusWeights> tristimulus_weights(const BandSet& bands, const Observer& observer,
                                                           const Illuminant& illuminant, Normalization normalization);
/// The same for emission: a spectral radiance in bands against the observer alone.
SPECTEX_API TristimulusWeights emission_weights(const BandSet& bands, const Observer& observer);

/// Correlated colour temperature of a light.
struct ColorTemperature {
    static constexpr double least_kelvin = 1000, most_kelvin = 1e6;
    std::optional<double> kelvin;  ///< none where the light lies farther than 0.05 from the locus, or beyond its ends
    double duv = 0;                ///< signed distance from the Planckian locus in CIE 1960 u, v: above it positive
};
/// The temperature of the Planckian radiator whose chromaticity by CIE 1931 is nearest in CIE 1960 u, v: bracketed on the
/// locus as integrated at 1 nm, and bisected to rounding.
/// Source: CIE 15:2018, 9.4. @error input, when nobody sees the light.
SPECTEX_API Result<ColorTemperature> correlated_color_temperature(const Illuminant& illuminant);

/// Which RGB-to-XYZ matrix a Colorimetry uses.
enum class RgbMatrix {
    integrated,  ///< from the primaries and the white integrated on this very grid: r = 1 is exactly (1,1,1)
    standard,    ///< from the primaries and the white chromaticity that the standard prints
};

/// The names that make a Colorimetry.
struct ColorimetrySpec {
    std::string observer = "cie1931";
    std::string illuminant;  ///< empty: the RGB space's own
    std::string rgb_space = "BT.709";
    RgbMatrix matrix = RgbMatrix::integrated;
};

/// Bands x observer x illuminant x RGB space. Owns the sensing matrix A with rgb_linear = A r; whatever solves, integrates
/// or checks takes A from here.
class SPECTEX_API Colorimetry {
public:
    static Result<Colorimetry> make(const ColorimetrySpec& spec, const BandSet& bands);
    /// The same with an illuminant of the caller's own.
    static Result<Colorimetry> make(const ColorimetrySpec& spec, const BandSet& bands, const Illuminant& illuminant);

    const BandSet& bands() const { return bands_; }
    const Observer& observer() const { return *observer_; }
    const Illuminant& illuminant() const { return illuminant_; }
    const RgbSpace& rgb_space() const { return space_; }
    RgbMatrix matrix_kind() const { return matrix_kind_; }

    /// [3][bands] row-major; rgb = A r.
    const std::vector<double>& sensing_matrix() const { return a_; }
    /// [3][bands] row-major; XYZ = W r, with Y = 1 for r = 1.
    const std::vector<double>& xyz_weights() const { return weights_.w; }
    const Vector3& white_xyz() const { return weights_.white; }
    const Matrix3& rgb_to_xyz() const { return rgb_to_xyz_; }
    const Matrix3& xyz_to_rgb() const { return xyz_to_rgb_; }

    /// Linear RGB of one reflectance, [bands]. Compensated.
    Vector3 rgb_of(std::span<const double> reflectance) const;
    /// One line for reports: "380:780:5, CIE 1931 2°, D65, BT.709, integrated white".
    std::string describe() const;

private:
    BandSet bands_;
    std::shared_ptr<const Observer> observer_;
    Illuminant illuminant_;
    RgbSpace space_;
    RgbMatrix matrix_kind_ = RgbMatrix::integrated;
    TristimulusWeights weights_;
    Matrix3 rgb_to_xyz_, xyz_to_rgb_;
    std::vector<double> a_;
};

/// Text of a data file of luts/, by its path below that folder ("cie/cie1931_2deg_360-830-1.csv"): from the folder that
/// the environment variable SPECTEX_LUTS names, else from share/spectex/luts beside the installed library, else as built in.
/// @error input, naming the path.
SPECTEX_API Result<std::string> lut_text(std::string_view path);
/// Where lut_text would take the file from: a path, or "built in".
SPECTEX_API std::string lut_origin(std::string_view path);

/// A CSV table: first column wavelength_nm, the others named.
struct SpectralTable {
    std::vector<double> wavelengths_nm;
    std::vector<std::string> names;
    std::vector<std::vector<double>> columns;  ///< [names][wavelengths]
};
/// @error input, naming `label` and the line.
SPECTEX_API Result<SpectralTable> parse_spectral_csv(std::string_view text, std::string_view label);
/// The same from a file of the caller's, of at most 64 MiB. @error input, naming the path.
SPECTEX_API Result<SpectralTable> read_spectral_csv(const std::string& path);
SPECTEX_API Result<SpectralTable> load_spectral_table(std::string_view lut_path);

/// Measured reflectances of one origin, dimensionless.
struct SampleSet {
    std::string name;
    std::vector<double> wavelengths_nm;        ///< ascending
    std::vector<std::vector<double>> samples;  ///< [samples][wavelengths]
};

}  // namespace spectex
