// Memory that a thread keeps from one piece of work to the next.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

namespace fingerflow {

// Whose it is: that of a piece of work, or of the caller of all pieces, who has two beside it.
enum class Keeper : int { kPiece, kCaller, kSums };

// At least `bytes` bytes, aligned to 64, with any content; valid until the thread asks again for the same keeper.
template <Keeper keeper = Keeper::kPiece>
inline void* workspace(std::size_t bytes) {
    static thread_local std::unique_ptr<unsigned char[]> memory;
    static thread_local std::size_t size = 0;
    if (size < bytes) {
        memory.reset();
        size = 0;
        memory.reset(new unsigned char[bytes + 63]());
        size = bytes;
    }
    return reinterpret_cast<void*>((reinterpret_cast<std::uintptr_t>(memory.get()) + 63) / 64 * 64);
}

}  // namespace fingerflow
