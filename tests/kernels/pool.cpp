// The pool of threads by itself, for a build with sanitizers: faults in any piece of any thread, callers side by side,
// calls within calls, forks.
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <new>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "parallel.h"

#ifndef _WIN32
#include <sys/wait.h>
#include <unistd.h>
#endif

namespace {

using namespace fingerflow;

std::atomic<int> failures{0};

void expect(bool right, const std::string& what) {
    if (right) return;
    std::printf("wrong: %s\n", what.c_str());
    ++failures;
}

// Every piece once, each in memory of its own.
void count_pieces(std::int64_t pieces, int threads) {
    std::vector<int> done(static_cast<std::size_t>(pieces));
    parallel_for(pieces, threads, [&](std::int64_t piece) { ++done[static_cast<std::size_t>(piece)]; });
    for (const int times : done) expect(times == 1, "a piece is done " + std::to_string(times) + " times");
}

enum class Came { kNothing, kNoMemory, kError, kUnknown };

template <class Work>
Came what_came(const Work& work) {
    try {
        work();
    } catch (const std::bad_alloc&) {
        return Came::kNoMemory;
    } catch (const std::exception&) {
        return Came::kError;
    } catch (...) {
        return Came::kUnknown;
    }
    return Came::kNothing;
}

// Whichever piece fails, on whichever thread: the exception comes out when nobody works any more, and the pool goes on.
void faults(int threads) {
    for (const Fault fault : {Fault::kNoMemory, Fault::kError, Fault::kUnknown})
        for (std::int64_t faulty = 0; faulty < 9; ++faulty) {
            std::atomic<int> inside{0};
            auto memory = std::vector<int>(9);
            inject_fault(fault, faulty, Thread::kAny);
            const Came came = what_came([&] {
                parallel_for(9, threads, [&](std::int64_t piece) {
                    ++inside;
                    std::this_thread::sleep_for(std::chrono::microseconds(100));
                    memory[static_cast<std::size_t>(piece)] = 1;
                    --inside;
                });
            });
            expect(inside == 0, "nobody works on after the exception");
            memory = std::vector<int>();
            inject_fault(Fault::kNone, 0, Thread::kAny);
            expect(static_cast<int>(came) == static_cast<int>(fault), "the exception that was thrown comes out");
            count_pieces(50, threads);
        }
}

// A thread of the pool fails, or the caller's own, while the others are at work.
void faults_of(Thread thread) {
    for (int time = 0; time < 20; ++time) {
        const std::thread::id caller = std::this_thread::get_id();
        std::atomic<bool> caller_came{false}, other_came{false};
        std::vector<int> memory(1000);
        const Came came = what_came([&] {
            parallel_for(1000, 3, [&](std::int64_t piece) {
                const bool mine = std::this_thread::get_id() == caller;
                (mine ? caller_came : other_came) = true;
                while (!caller_came || !other_came) std::this_thread::yield();
                if (mine == (thread == Thread::kCaller)) throw std::bad_alloc();
                for (int repeat = 0; repeat < 1000; ++repeat) memory[static_cast<std::size_t>(piece)] += repeat;
            });
        });
        expect(came == Came::kNoMemory, "a fault of one kind of thread");
        count_pieces(50, 3);
    }
}

void no_threads() {
    inject_fault(Fault::kNoThread, -1, Thread::kAny);
    count_pieces(100, 64);
    inject_fault(Fault::kNone, -1, Thread::kAny);
}

// Callers side by side, one of which fails now and then: to each its own.
void side_by_side() {
    std::vector<std::thread> callers;
    for (int number = 0; number < 4; ++number)
        callers.emplace_back([number] {
            for (int time = 0; time < 200; ++time) {
                count_pieces(1 + time % 40, 1 + (time + number) % 5);
                if (number == 0 && time % 10 == 0)
                    expect(what_came([] { parallel_for(30, 3, [](std::int64_t) { throw std::runtime_error("one"); }); }) == Came::kError,
                           "the caller's own exception");
            }
        });
    for (std::thread& caller : callers) caller.join();
}

// Two callers at once: the second is helped, and does not wait for the first.
void no_caller_waits_for_another() {
    std::atomic<bool> second_is_done{false};
    std::thread first([&] {
        parallel_for(2, 2, [&](std::int64_t) {
            while (!second_is_done) std::this_thread::yield();
        });
    });
    count_pieces(20, 2);
    second_is_done = true;
    first.join();
}

void within() {
    std::atomic<int> done{0};
    parallel_for(6, 3, [&](std::int64_t) { parallel_for(7, 3, [&](std::int64_t) { ++done; }); });
    expect(done == 42, "pieces within pieces");
}

// A child has the pool of its parent and none of its threads; the parent may be at work, in another thread, meanwhile.
void forked() {
#ifndef _WIN32
    std::atomic<bool> stop{false};
    std::thread busy([&] {
        while (!stop) count_pieces(20, 3);
    });
    for (int time = 0; time < 10; ++time) {
        const pid_t child = fork();
        if (child == 0) {
            alarm(20);  // a child that hangs ends as one that fails
            std::atomic<int> done{0};
            parallel_for(100, 3, [&](std::int64_t) { ++done; });
            const Came came = what_came([] { parallel_for(9, 3, [](std::int64_t) { throw std::bad_alloc(); }); });
            _exit(done == 100 && came == Came::kNoMemory ? 0 : 1);
        }
        int status = 1;
        waitpid(child, &status, 0);
        expect(WIFEXITED(status) && WEXITSTATUS(status) == 0, "a forked child");
        count_pieces(20, 3);
    }
    stop = true;
    busy.join();
#endif
}

}  // namespace

int main() {
    no_threads();
    for (const int threads : {1, 2, 5}) {
        count_pieces(0, threads);
        count_pieces(1, threads);
        count_pieces(1000, threads);
        faults(threads);
    }
    faults_of(Thread::kCaller);
    faults_of(Thread::kPool);
    side_by_side();
    no_caller_waits_for_another();
    within();
    forked();
    std::printf("%d failures\n", failures.load());
    return failures != 0;
}
