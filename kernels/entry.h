// From one block of memory that Python packed to the arguments of a function of interface.h, and from what the function
// throws to a number. generate_entries.py writes one such entry a function.
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

// The outcome of the exception that is being handled; what it says is kept for the thread.
int outcome_of_exception() noexcept;

// What the last call of this thread that failed had to say.
const char* last_message() noexcept;

// Every argument begins at a multiple of 8 bytes: a number, an address, or a whole structure, which is handed on in place.
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
        const std::tuple<Arguments...> arguments{unpacked<Arguments>(at)...};  // in this order: they stand in braces
        std::apply(function, arguments);
        return kDone;
    } catch (...) {
        return outcome_of_exception();
    }
}

}  // namespace fingerflow
