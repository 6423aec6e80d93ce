// Numbers of 113 bits of mantissa and an exponent that no colour reaches the end of: what references are computed in.
//
// Where long double is such a number (Arm), that; on x86-64 the compilers' __float128, with the elementary functions of the C
// library, which has them under their standard names. Only this room's own translation units include it.
#pragma once

#include <cfloat>
#include <cmath>

#if LDBL_MANT_DIG < 113
#if !defined(__SIZEOF_FLOAT128__)
#error "expected a long double of 113 bits, or __float128"
#endif
extern "C" {
// As <math.h> declares them for GCC, and for Clang not.
__float128 sqrtf128(__float128) noexcept;
__float128 cbrtf128(__float128) noexcept;
__float128 powf128(__float128, __float128) noexcept;
__float128 expf128(__float128) noexcept;
__float128 log1pf128(__float128) noexcept;
__float128 sinf128(__float128) noexcept;
__float128 cosf128(__float128) noexcept;
__float128 atan2f128(__float128, __float128) noexcept;
}
#endif

namespace spectex::quad {

#if LDBL_MANT_DIG >= 113
using Quad = long double;
#else
using Quad = __float128;
inline Quad sqrt(Quad x) { return sqrtf128(x); }
inline Quad cbrt(Quad x) { return cbrtf128(x); }
inline Quad pow(Quad x, Quad y) { return powf128(x, y); }
inline Quad exp(Quad x) { return expf128(x); }
inline Quad log1p(Quad x) { return log1pf128(x); }
inline Quad sin(Quad x) { return sinf128(x); }
inline Quad cos(Quad x) { return cosf128(x); }
inline Quad atan2(Quad y, Quad x) { return atan2f128(y, x); }
#endif
// The quick look of 64 bits or more that decides whether a case is worth the slow one.
inline long double sqrt(long double x) { return std::sqrt(x); }
inline long double cbrt(long double x) { return std::cbrt(x); }
inline long double pow(long double x, long double y) { return std::pow(x, y); }
inline long double exp(long double x) { return std::exp(x); }
inline long double log1p(long double x) { return std::log1p(x); }
inline long double sin(long double x) { return std::sin(x); }
inline long double cos(long double x) { return std::cos(x); }
inline long double atan2(long double y, long double x) { return std::atan2(y, x); }

template <class Real>
Real abs(Real x) {
    return x < 0 ? -x : x;
}
template <class Real>
Real larger(Real a, Real b) {
    return a < b ? b : a;
}

}  // namespace spectex::quad
