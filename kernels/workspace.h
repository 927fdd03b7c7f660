// Workspace that each thread keeps from one piece to the next.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

namespace fingerflow {

// Independent workspaces of a thread: for a piece, for the caller of all pieces, and for the caller's sums.
enum class Keeper : int { kPiece, kCaller, kSums };

// At least `bytes` bytes, aligned to 64, of any content; valid until the thread's next request for the same keeper.
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
