// A pool of threads that share the pieces of parallel_for. Each thread takes the next piece by an atomic counter, so
// that the distribution adapts to their speed; results must not depend on it.
// Layout: one Job a call, on the caller's stack, linked into the pool's list; threads live as long as the process.
#include "parallel.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <new>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <vector>

#ifndef _WIN32
#include <pthread.h>
#endif

#include "interface.h"

namespace fingerflow {
namespace {

std::atomic<Fault> fault_to_inject{Fault::kNone};
std::atomic<std::int64_t> faulty_piece{-1};
std::atomic<Thread> faulty_thread{Thread::kAny};

void fail_if_asked(std::int64_t piece, Thread thread) {
    const Fault fault = fault_to_inject.load(std::memory_order_relaxed);
    if (fault == Fault::kNone || fault == Fault::kNoThread) return;
    const std::int64_t wanted = faulty_piece.load();
    const Thread where = faulty_thread.load();
    if ((wanted >= 0 && wanted != piece) || (where != Thread::kAny && where != thread)) return;
    if (fault == Fault::kNoMemory) throw std::bad_alloc();
    if (fault == Fault::kError) throw std::runtime_error("a fault injected by a test");
    throw 1;
}

// The work of one call of parallel_for. It lies on the caller's stack: the caller returns last.
struct Job {
    Job(std::int64_t count, int helpers, void (*each)(const void*, std::int64_t), const void* what)
        : call(each), work(what), pieces(count), places(helpers) {}

    void take(Thread thread) {
        for (std::int64_t piece = next.fetch_add(1); piece < pieces; piece = next.fetch_add(1)) {
            try {
                fail_if_asked(piece, thread);
                call(work, piece);
            } catch (...) {
                if (!failed.exchange(true)) failure = std::current_exception();
                next.store(pieces);
                return;
            }
        }
    }

    bool has_room() const { return places > 0 && next.load(std::memory_order_relaxed) < pieces; }

    void (*const call)(const void* work, std::int64_t piece);
    const void* const work;
    const std::int64_t pieces;
    std::atomic<std::int64_t> next{0};
    std::atomic<bool> failed{false};
    std::exception_ptr failure;  // of the thread that failed first; read when all have finished
    int places;                  // number of pool threads that may still join; under the pool's lock
    std::atomic<int> inside{0};  // number of pool threads at work; changed under the pool's lock
    Job* following = nullptr;
};

// Threads are kept, since starting one takes longer than filtering a frame. They serve all callers.
class Pool {
public:
    void run(Job& job) {
        const int helpers = job.places;
        {
            std::lock_guard<std::mutex> lock(mutex_);
            asked_ += helpers;
            grow(helpers);
            Job** last = &jobs_;
            while (*last != nullptr) last = &(*last)->following;
            *last = &job;
            round_.fetch_add(1);
        }
        start_.notify_all();
        job.take(Thread::kCaller);
        {
            std::lock_guard<std::mutex> lock(mutex_);
            asked_ -= helpers;
            Job** place = &jobs_;
            while (*place != &job) place = &(*place)->following;
            *place = job.following;  // threads that have not woken up yet are not waited for
        }
        spin([&job] { return job.inside.load() == 0; });
        std::unique_lock<std::mutex> lock(mutex_);
        done_.wait(lock, [&job] { return job.inside.load() == 0; });
    }

private:
    // Starts as many threads as all callers request together; more than processors only if a single caller requests
    // them.
    void grow(int helpers) {
        static const int processors = static_cast<int>(std::thread::hardware_concurrency());
        const int wanted = std::max(helpers, std::min(asked_, processors - 1));
        try {
            while (static_cast<int>(workers_.size()) < wanted) {
                if (fault_to_inject.load() == Fault::kNoThread) throw std::system_error(EAGAIN, std::generic_category());
                workers_.emplace_back([this] { serve(); });
            }
        } catch (const std::system_error&) {  // the existing threads do the work, or the caller alone
        } catch (const std::bad_alloc&) {
        }
    }

    // Busy-waits up to 50 us: waking up takes longer than many pieces of work.
    template <class Done>
    static void spin(const Done& done) {
        const auto end = std::chrono::steady_clock::now() + std::chrono::microseconds(50);
        while (!done() && std::chrono::steady_clock::now() < end) {
        }
    }

    Job* job_with_room() const {
        Job* job = jobs_;
        while (job != nullptr && !job->has_room()) job = job->following;
        return job;
    }

    void serve() {
        std::unique_lock<std::mutex> lock(mutex_);
        for (;;) {
            Job* job = nullptr;
            start_.wait(lock, [&] { return (job = job_with_room()) != nullptr; });
            --job->places;
            ++job->inside;
            const std::uint64_t seen = round_.load();
            lock.unlock();
            job->take(Thread::kPool);
            lock.lock();
            if (--job->inside == 0) done_.notify_all();
            lock.unlock();
            spin([&] { return round_.load() != seen; });
            lock.lock();
        }
    }

    std::mutex mutex_;
    std::condition_variable start_, done_;
    std::vector<std::thread> workers_;
    Job* jobs_ = nullptr;                  // in order of the calls
    int asked_ = 0;                        // threads that all callers request beside their own
    std::atomic<std::uint64_t> round_{0};  // incremented with every job
};

// Never destroyed, since its threads may outlive static objects.
alignas(Pool) unsigned char storage[sizeof(Pool)];
Pool* const pool = new (&storage) Pool;

#ifndef _WIN32
// A forked child has none of its parent's threads and may inherit a held lock: it starts a new pool.
const int registered = pthread_atfork(nullptr, nullptr, [] { new (&storage) Pool; });
#endif

}  // namespace

void inject_fault(Fault fault, std::int64_t piece, Thread thread) {
    faulty_piece.store(piece);
    faulty_thread.store(thread);
    fault_to_inject.store(fault);
}

void run_pieces(std::int64_t pieces, int threads, void (*call)(const void*, std::int64_t), const void* work) {
    if (threads > pieces) threads = static_cast<int>(pieces);
    Job job(pieces, threads > 1 ? threads - 1 : 0, call, work);
    if (threads <= 1)
        job.take(Thread::kCaller);
    else
        pool->run(job);
    if (job.failure) std::rethrow_exception(job.failure);
}

}  // namespace fingerflow

// For tests: faults and threads of parallel.h, by their numbers.
void fingerflow_inject_fault(int fault, std::int64_t piece /* from -1 */, int thread) {
    fingerflow::inject_fault(static_cast<fingerflow::Fault>(fault), piece, static_cast<fingerflow::Thread>(thread));
}
