// Parallel loops over pieces of work, on the calling thread and a pool.
#pragma once

#include <cstdint>
#include <functional>

namespace fingerflow {

// Calls work(piece) once for each piece = 0 ... pieces - 1, on up to `threads` threads (or as many as the system can
// start), and returns when all are done. If a piece throws, no further piece begins, and the first exception is
// rethrown here once every thread has finished. May be called from several threads at once, from within a piece, and
// after a fork.
void parallel_for(std::int64_t pieces, int threads, const std::function<void(std::int64_t)>& work);

// For tests: pieces that fail, and a system that starts no threads.
enum class Fault : int { kNone, kNoMemory, kError, kUnknown, kNoThread };
enum class Thread : int { kAny, kCaller, kPool };

// From now on the piece of this index (any piece if negative) throws when a thread of this kind begins it.
void inject_fault(Fault fault, std::int64_t piece, Thread thread);

}  // namespace fingerflow
