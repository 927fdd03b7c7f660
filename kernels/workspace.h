// Workspace that each thread keeps from one piece to the next.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fingerflow {

// Independent workspaces of a thread: for a piece, for the caller of all pieces, and for the caller's sums.
enum class Keeper : int { kPiece, kCaller, kSums };

// At least `bytes` bytes, aligned to 64, of any content; valid until the thread's next request for the same keeper.
template <Keeper keeper = Keeper::kPiece>
inline void* workspace(std::size_t bytes) {
    static thread_local struct Memory {
        unsigned char* begin = nullptr;
        std::size_t size = 0;
        ~Memory() { delete[] begin; }
    } memory;
    if (memory.size < bytes) {
        delete[] memory.begin;
        memory.begin = nullptr, memory.size = 0;  // should there be no memory
        memory.begin = new unsigned char[bytes + 63]();
        memory.size = bytes;
    }
    return reinterpret_cast<void*>((reinterpret_cast<std::uintptr_t>(memory.begin) + 63) / 64 * 64);
}

}  // namespace fingerflow
