// Work shared between threads, and memory that is kept. Shared by all kernels of this folder.

#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <vector>

#if defined(_WIN32)
#include <chrono>
#include <process.h>
#else
#include <time.h>
#include <unistd.h>
#endif

namespace f4x {

constexpr int GRAIN = 1024;  // items per unit of parallel work

inline int64_t process_id() {
#if defined(_WIN32)
    return _getpid();
#else
    return getpid();
#endif
}

// The threads that help callers, asleep between calls: a fit makes dozens of calls per step, and starting threads for each took
// longer than many of them. A caller works itself and waits only for helpers that came in time, so a busy machine delays no
// one. The threads are never ended: they hold nothing, and the process may end while they sleep.
class Helpers {
    struct Job {
        const std::function<void()>& work;
        int64_t wanted, inside = 0;
    };

    std::mutex mutex_;
    std::condition_variable wanted_, left_;
    std::vector<Job*> jobs_;
    int64_t started_ = 0;
    const int64_t owner_ = process_id();

    Job* open_job() {
        for (Job* job : jobs_)
            if (job->wanted > 0) return job;
        return nullptr;
    }

    void help() {
        std::unique_lock<std::mutex> lock(mutex_);
        for (;;) {
            Job* job;
            wanted_.wait(lock, [&] { return (job = open_job()) != nullptr; });
            --job->wanted;
            ++job->inside;
            lock.unlock();
            job->work();
            lock.lock();
            if (--job->inside == 0) left_.notify_all();
        }
    }

    void start(int64_t count) {
        try {
            for (; started_ < count; ++started_) std::thread([this] { help(); }).detach();
        } catch (const std::system_error&) {
            // No more threads to be had: the ones that started do the work.
        }
    }

public:
    // Runs `work`, which must not throw, here and on up to `helpers` more threads.
    void run(int64_t helpers, const std::function<void()>& work) {
        Job job{work, helpers};
        {
            std::lock_guard<std::mutex> lock(mutex_);
            start(helpers);
            jobs_.push_back(&job);
        }
        for (int64_t i = 0; i < helpers; ++i) wanted_.notify_one();
        work();
        std::unique_lock<std::mutex> lock(mutex_);
        jobs_.erase(std::find(jobs_.begin(), jobs_.end(), &job));
        left_.wait(lock, [&] { return job.inside == 0; });
    }

    // Those of this process: a forked child has none of its parent's threads.
    static Helpers& of_process() {
        static std::atomic<Helpers*> shared{nullptr};
        Helpers* helpers = shared;
        if (helpers && helpers->owner_ == process_id()) return *helpers;
        auto fresh = std::make_unique<Helpers>();
        if (shared.compare_exchange_strong(helpers, fresh.get())) return *fresh.release();  // never deleted, see above
        return *helpers;  // another thread was first
    }
};

// Nanoseconds of processor time of this thread; of the clock where the system does not count finely enough.
inline int64_t thread_nanoseconds() {
#if defined(_WIN32)
    return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
#else
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return int64_t(now.tv_sec) * 1000000000 + now.tv_nsec;
#endif
}

// What callers have spent on work that threads can share: profiles tell from it what one thread has to do alone.
inline std::atomic<int64_t> shareable_nanoseconds{0};

struct ShareableTime {
    const int64_t start = thread_nanoseconds();
    ~ShareableTime() { shareable_nanoseconds += thread_nanoseconds() - start; }
};

// Runs body(cursor) on every worker; bodies draw work items from the shared cursor.
template <class Body>
void parallel(int threads, int64_t items, const Body& body) {
    const ShareableTime timed;
    std::atomic<int64_t> cursor{0};
    const int64_t helpers = std::min<int64_t>(threads, items) - 1;
    if (helpers <= 0) return body(cursor);
    std::exception_ptr failure;
    std::mutex mutex;
    Helpers::of_process().run(helpers, [&] {
        try {
            body(cursor);
        } catch (...) {
            std::lock_guard<std::mutex> lock(mutex);
            failure = std::current_exception();
        }
    });
    if (failure) std::rethrow_exception(failure);
}

template <class Work>
void parallel_ranges(int threads, int64_t count, const Work& work) {
    const int64_t items = (count + GRAIN - 1) / GRAIN;
    parallel(threads, items, [&](std::atomic<int64_t>& cursor) {
        for (int64_t i; (i = cursor++) < items;) work(i * GRAIN, std::min(count, (i + 1) * GRAIN));
    });
}

// Uninitialised, 64-byte aligned, keeps its memory when it shrinks.
template <class T>
class Buffer {
    T* data_ = nullptr;
    size_t capacity_ = 0;

public:
    Buffer() = default;
    Buffer(const Buffer&) = delete;
    Buffer& operator=(const Buffer&) = delete;
    ~Buffer() { release(); }
    void release() {
        if (data_) ::operator delete(data_, std::align_val_t(64));
        data_ = nullptr;
        capacity_ = 0;
    }
    T* resize(size_t n) {
        if (n > capacity_) {
            release();
            data_ = static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(64)));
            capacity_ = n;
        }
        return data_;
    }
    operator T*() const { return data_; }
};

}  // namespace f4x
