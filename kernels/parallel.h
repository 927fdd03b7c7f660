// Parallel loops over pieces of work, on the calling thread and a pool.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fingerflow {

// A count or an index as the standard library takes it.
inline std::size_t size(std::int64_t count) { return static_cast<std::size_t>(count); }

// Calls call(work, piece), see parallel_for.
void run_pieces(std::int64_t pieces, int threads, void (*call)(const void* work, std::int64_t piece), const void* work);

// Calls work(piece) once for each piece = 0 ... pieces - 1, on up to `threads` threads (or as many as the system can
// start), and returns when all are done. If a piece throws, no further piece begins, and the first exception is
// rethrown here once every thread has finished. May be called from several threads at once, from within a piece, and
// after a fork.
template <class Work>
void parallel_for(std::int64_t pieces, int threads, const Work& work) {
    run_pieces(pieces, threads, [](const void* of, std::int64_t piece) { (*static_cast<const Work*>(of))(piece); }, &work);
}

// Calls work(frame, top, bottom) for pieces of up to `rows` rows of each frame.
template <class Work>
void for_bands(std::int64_t batch, std::int64_t height, std::int64_t rows, int threads, const Work& work) {
    const std::int64_t pieces = (height + rows - 1) / rows;
    parallel_for(batch * pieces, threads, [&](std::int64_t piece) {
        const std::int64_t top = piece % pieces * rows;
        work(piece / pieces, top, top + rows < height ? top + rows : height);
    });
}

// Calls work(first, last) for pieces of up to `at_a_time` of `count` points.
template <class Work>
void for_ranges(std::int64_t count, std::int64_t at_a_time, int threads, const Work& work) {
    parallel_for((count + at_a_time - 1) / at_a_time, threads, [&](std::int64_t piece) {
        const std::int64_t end = (piece + 1) * at_a_time;
        work(piece * at_a_time, end < count ? end : count);
    });
}

// For tests: pieces that fail, and a system that starts no threads.
enum class Fault : int { kNone, kNoMemory, kError, kUnknown, kNoThread };
enum class Thread : int { kAny, kCaller, kPool };

// From now on the piece of this index (any piece if negative) throws when a thread of this kind begins it.
void inject_fault(Fault fault, std::int64_t piece, Thread thread);

}  // namespace fingerflow
