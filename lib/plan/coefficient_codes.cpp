#include "plan/coefficient_codes.h"

#include <array>
#include <bit>

#include "spectex/color.h"

namespace spectex::plan {
namespace {

/// Finds the code of a float by its exponent and first bits, and a step or two along the limits between codes.
class SrgbCodes {
public:
    SrgbCodes() {
        for (std::size_t i = 0; i < 256; ++i) {
            table_[i] = static_cast<float>(srgb_decode(static_cast<double>(i) / 255));
            limits_[i] = i == 0 ? 0 : srgb_decode((static_cast<double>(i) - 0.5) / 255);
        }
        for (std::size_t k = 0; k < first_.size(); ++k) {
            const auto least = static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(k) << shift));
            std::size_t code = 0;
            while (code < 255 && least >= limits_[code + 1]) ++code;
            first_[k] = static_cast<std::uint8_t>(code);
        }
    }
    const float* table() const { return table_.data(); }
    std::uint8_t code(float value) const {
        if (!(value > 0)) return 0;
        if (value >= 1) return 255;
        std::size_t code = first_[std::bit_cast<std::uint32_t>(value) >> shift];
        while (code < 255 && static_cast<double>(value) >= limits_[code + 1]) ++code;
        return static_cast<std::uint8_t>(code);
    }

private:
    static constexpr unsigned shift = 16;
    std::array<float, 256> table_{};
    std::array<double, 256> limits_{};
    std::array<std::uint8_t, (std::bit_cast<std::uint32_t>(1.0f) >> shift) + 1> first_{};
};

const SrgbCodes& srgb_codes() {
    static const SrgbCodes codes;
    return codes;
}

}  // namespace

bool fits_codes(const Model& model) {
    return model.info().pieces != Pieces::nonlinear || model.info().id == "peters2019:fourier-srgb";
}

const float* code_table() { return srgb_codes().table(); }

void encode_codes(const float* values, std::size_t n, std::uint8_t* codes) {
    const SrgbCodes& srgb = srgb_codes();
    for (std::size_t i = 0; i < n; ++i) codes[i] = srgb.code(values[i]);
}

}  // namespace spectex::plan
