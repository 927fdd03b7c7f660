#include "parallel.h"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#ifndef _WIN32
#include <pthread.h>
#endif

namespace fingerflow {
namespace {

// Threads live as long as the process: starting one takes longer than filtering a frame.
class Pool {
public:
    void run(std::int64_t pieces, int threads, const std::function<void(std::int64_t)>& work) {
        {
            std::lock_guard<std::mutex> lock(mutex_);
            while (static_cast<int>(workers_.size()) < threads - 1) workers_.emplace_back([this] { serve(); });
            work_ = &work;
            pieces_ = pieces;
            next_.store(0);
            wanted_ = threads - 1;
            ++round_;
        }
        start_.notify_all();
        take(pieces, work);
        {
            std::lock_guard<std::mutex> lock(mutex_);
            wanted_ = 0;  // whoever has not woken up yet is not waited for
        }
        spin([this] { return busy_.load() == 0; });
        std::unique_lock<std::mutex> lock(mutex_);
        done_.wait(lock, [this] { return busy_.load() == 0; });
    }

private:
    // Waits for a while without sleeping: waking up takes longer than many a piece of work.
    template <class Done>
    static void spin(const Done& done) {
        const auto end = std::chrono::steady_clock::now() + std::chrono::microseconds(50);
        while (!done() && std::chrono::steady_clock::now() < end) {
        }
    }

    void take(std::int64_t pieces, const std::function<void(std::int64_t)>& work) {
        for (std::int64_t piece = next_.fetch_add(1); piece < pieces; piece = next_.fetch_add(1)) work(piece);
    }

    void serve() {
        std::uint64_t seen = 0;
        std::unique_lock<std::mutex> lock(mutex_);
        for (;;) {
            start_.wait(lock, [&] { return round_.load() != seen && wanted_ > 0; });
            seen = round_.load();
            --wanted_;
            ++busy_;
            const std::int64_t pieces = pieces_;
            const auto& work = *work_;
            lock.unlock();
            take(pieces, work);
            lock.lock();
            if (--busy_ == 0) done_.notify_one();
            lock.unlock();
            spin([&] { return round_.load() != seen; });
            lock.lock();
        }
    }

    std::mutex mutex_;
    std::condition_variable start_, done_;
    std::vector<std::thread> workers_;
    const std::function<void(std::int64_t)>* work_ = nullptr;
    std::int64_t pieces_ = 0;
    std::atomic<std::int64_t> next_{0};
    int wanted_ = 0;
    std::atomic<int> busy_{0};
    std::atomic<std::uint64_t> round_{0};
};

std::mutex one_at_a_time;
Pool* pool = nullptr;  // never destroyed: its threads may outlive static objects

#ifndef _WIN32
// A forked child has none of its parent's threads: it starts its own.
void start_afresh() {
    new (&one_at_a_time) std::mutex;
    pool = nullptr;
}
const int registered = pthread_atfork(nullptr, nullptr, start_afresh);
#endif

}  // namespace

void parallel_for(std::int64_t pieces, int threads, const std::function<void(std::int64_t)>& work) {
    if (threads > pieces) threads = static_cast<int>(pieces);
    // One thread may be a piece of other work, which holds the lock.
    std::unique_lock<std::mutex> turn(one_at_a_time, std::defer_lock);
    if (threads <= 1 || !turn.try_lock()) {  // the threads serve another caller, whose own thread works beside this one
        for (std::int64_t piece = 0; piece < pieces; ++piece) work(piece);
        return;
    }
    if (pool == nullptr) pool = new Pool;
    pool->run(pieces, threads, work);
}

}  // namespace fingerflow
