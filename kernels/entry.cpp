// Status codes of exceptions at the library's C boundary: kNoMemory for std::bad_alloc and std::length_error, kFailed
// else.
// Layout: one message of up to 255 bytes a thread, which Python reads after a call that failed.
#include "entry.h"

#include <cstdio>
#include <exception>
#include <new>
#include <stdexcept>

namespace fingerflow {
namespace {

thread_local char message[256] = "";

void keep(const char* text) noexcept { std::snprintf(message, sizeof message, "%s", text); }

}  // namespace

int outcome_of_exception() noexcept {
    try {
        throw;
    } catch (const std::bad_alloc& error) {
        keep(error.what());
        return kNoMemory;
    } catch (const std::length_error& error) {  // thrown by a vector that would exceed any memory
        keep(error.what());
        return kNoMemory;
    } catch (const std::exception& error) {
        keep(error.what());
    } catch (...) {
        keep("something that is no std::exception was thrown");
    }
    return kFailed;
}

const char* last_message() noexcept { return message; }

}  // namespace fingerflow

FINGERFLOW_EXPORT const char* fingerflow_last_message() { return fingerflow::last_message(); }
