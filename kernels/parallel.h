// Pieces of work shared out to the calling thread and a few waiting ones.
#pragma once

#include <cstdint>
#include <functional>

namespace fingerflow {

// Calls work(piece) for piece = 0 ... pieces - 1, each once, on up to `threads` threads, or on as many as the system gives,
// and returns when all are done. Where a piece throws, on whichever thread, no further piece begins, and the first
// exception comes out of here once every thread has left the work. May be called from several threads at once, from
// within a piece, and after a fork.
void parallel_for(std::int64_t pieces, int threads, const std::function<void(std::int64_t)>& work);

// For tests: pieces that fail, and a system that gives no threads.
enum class Fault : int { kNone, kNoMemory, kError, kUnknown, kNoThread };
enum class Thread : int { kAny, kCaller, kPool };

// From now on the piece of this number, or every piece where it is negative, throws where such a thread begins it.
void inject_fault(Fault fault, std::int64_t piece, Thread thread);

}  // namespace fingerflow
