// Pieces of work shared out to the calling thread and a few waiting ones.
#pragma once

#include <cstdint>
#include <functional>

namespace fingerflow {

// Calls work(piece) for piece = 0 ... pieces - 1, each once, on up to `threads` threads, and returns when all are done.
void parallel_for(std::int64_t pieces, int threads, const std::function<void(std::int64_t)>& work);

}  // namespace fingerflow
