// A system that has no memory for the n-th request of a kernel: `operator new` replaced in a process of its own, by
// LD_PRELOAD (short_of_memory.py).
#include <atomic>
#include <cstddef>
#include <cstdlib>
#include <new>

namespace {

std::atomic<long> left{-1};  // requests until one is refused; negative for never
std::atomic<long> refused{0};

}  // namespace

extern "C" void refuse_request(long number) {
    refused.store(0);
    left.store(number);
}

extern "C" long requests_refused() { return refused.load(); }

void* operator new(std::size_t bytes) {
    if (left.load() >= 0 && left.fetch_sub(1) == 0) {
        refused.fetch_add(1);
        throw std::bad_alloc();
    }
    void* const memory = std::malloc(bytes > 0 ? bytes : 1);
    if (memory == nullptr) throw std::bad_alloc();
    return memory;
}

void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
