// Results and errors shared by every room.
//
// No function of the library throws to its caller, and none returns a default value in place of an answer: what can fail
// returns a Result. An Error's message is one sentence that names the file, channel, pixel or option and what was expected.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

#if defined(__GNUC__)
#define SPECTEX_API __attribute__((visibility("default")))
#else
#define SPECTEX_API
#endif

namespace spectex {

/// What went wrong, coarse enough to become an exit code.
enum class ErrorKind {
    usage,        ///< the request is malformed or contradicts itself (exit code 64)
    input,        ///< a file or value that was read is unusable (2)
    output,       ///< something could not be written (2)
    infeasible,   ///< no spectrum satisfies the request; the message bears the certificate's figures (2)
    interrupted,  ///< the caller asked to stop
};

struct Error {
    ErrorKind kind = ErrorKind::input;
    std::string message;
};

/// A value or the Error that stands in its place.
template <class T>
class [[nodiscard]] Result {
public:
    Result(T value) : state_(std::in_place_index<0>, std::move(value)) {}
    Result(Error error) : state_(std::in_place_index<1>, std::move(error)) {}

    explicit operator bool() const { return state_.index() == 0; }
    bool ok() const { return state_.index() == 0; }

    T& value() & { return std::get<0>(state_); }
    const T& value() const& { return std::get<0>(state_); }
    T&& value() && { return std::get<0>(std::move(state_)); }
    T& operator*() & { return std::get<0>(state_); }
    const T& operator*() const& { return std::get<0>(state_); }
    T&& operator*() && { return std::get<0>(std::move(state_)); }
    T* operator->() { return &std::get<0>(state_); }
    const T* operator->() const { return &std::get<0>(state_); }

    const Error& error() const& { return std::get<1>(state_); }
    Error&& error() && { return std::get<1>(std::move(state_)); }

private:
    std::variant<T, Error> state_;
};

/// Success, or an Error.
template <>
class [[nodiscard]] Result<void> {
public:
    Result() = default;
    Result(Error error) : error_(std::move(error)), ok_(false) {}

    explicit operator bool() const { return ok_; }
    bool ok() const { return ok_; }
    const Error& error() const { return error_; }

private:
    Error error_;
    bool ok_ = true;
};

using Status = Result<void>;

/// Column vector of three components: tristimulus XYZ, linear RGB, or Lab, as the name says.
using Vector3 = std::array<double, 3>;

/// 3x3 matrix, row-major, that multiplies column vectors from the left.
struct Matrix3 {
    std::array<double, 9> m{1, 0, 0, 0, 1, 0, 0, 0, 1};

    double operator()(std::size_t row, std::size_t column) const { return m[3 * row + column]; }
    double& operator()(std::size_t row, std::size_t column) { return m[3 * row + column]; }

    Vector3 operator*(const Vector3& v) const {
        return {m[0] * v[0] + m[1] * v[1] + m[2] * v[2], m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
                m[6] * v[0] + m[7] * v[1] + m[8] * v[2]};
    }
    Matrix3 operator*(const Matrix3& b) const {
        Matrix3 r;
        for (std::size_t i = 0; i < 3; ++i)
            for (std::size_t j = 0; j < 3; ++j)
                r(i, j) = (*this)(i, 0) * b(0, j) + (*this)(i, 1) * b(1, j) + (*this)(i, 2) * b(2, j);
        return r;
    }
    bool operator==(const Matrix3&) const = default;

    /// Inverse by cofactors in long double; a singular matrix gives non-finite entries, which callers exclude by
    /// construction (primaries that span a triangle, adaptation matrices of full rank).
    SPECTEX_API Matrix3 inverse() const;
};

/// Version of the library, "major.minor.patch".
SPECTEX_API std::string_view version();

}  // namespace spectex
