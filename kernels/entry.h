// Entries of the library: a block of memory that Python packed is unpacked to the arguments of a function of
// the library, and exceptions become status codes. generate_entries.py writes one entry for each function.
#pragma once

#include <cstdint>
#include <cstring>
#include <tuple>
#include <type_traits>

#ifdef _WIN32
#define FINGERFLOW_EXPORT extern "C" __declspec(dllexport)
#else
#define FINGERFLOW_EXPORT extern "C" __attribute__((visibility("default")))
#endif

namespace fingerflow {

enum Outcome : int { kDone = 0, kNoMemory = 1, kFailed = 2 };

// Status code of the exception being handled; its message is kept for the thread.
int outcome_of_exception() noexcept;

// Message of this thread's last failed call.
const char* last_message() noexcept;

// Next argument: a number, an address, or a structure, passed by its address in the block. Each begins at a multiple of
// 8 bytes.
template <class Argument>
Argument unpacked(const unsigned char*& at) {
    constexpr bool whole = std::is_pointer_v<Argument> && std::is_class_v<std::remove_pointer_t<Argument>>;
    if constexpr (whole) {
        using Structure = std::remove_pointer_t<Argument>;
        static_assert(alignof(Structure) <= 8 && std::is_const_v<Structure>, "a structure is given, and stays as it is");
        const auto argument = reinterpret_cast<Argument>(at);
        at += (sizeof(Structure) + 7) / 8 * 8;
        return argument;
    } else {
        static_assert(sizeof(Argument) <= 8, "numbers and addresses");
        Argument argument;
        std::memcpy(&argument, at, sizeof argument);
        at += 8;
        return argument;
    }
}

template <class... Arguments>
int enter(void (*function)(Arguments...), const void* packed) noexcept {
    try {
        auto at = static_cast<const unsigned char*>(packed);
        const std::tuple<Arguments...> arguments{unpacked<Arguments>(at)...};  // braces guarantee the order of evaluation
        std::apply(function, arguments);
        return kDone;
    } catch (...) {
        return outcome_of_exception();
    }
}

}  // namespace fingerflow
