// Work shared between threads, and memory that is kept. Shared by all kernels of this folder.

#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <vector>

namespace f4x {

constexpr int GRAIN = 1024;  // items per unit of parallel work

// Runs body(cursor) on every worker; bodies draw work items from the shared cursor. Threads live for one call only:
// nothing to shut down at exit, nothing to lose in a fork.
template <class Body>
void parallel(int threads, int64_t items, const Body& body) {
    std::atomic<int64_t> cursor{0};
    std::exception_ptr failure;
    std::mutex mutex;
    auto work = [&] {
        try {
            body(cursor);
        } catch (...) {
            std::lock_guard<std::mutex> lock(mutex);
            failure = std::current_exception();
        }
    };
    std::vector<std::thread> team;
    const int64_t helpers = std::min<int64_t>(threads, items) - 1;
    try {
        for (int64_t i = 0; i < helpers; ++i) team.emplace_back(work);
    } catch (const std::system_error&) {
        // No more threads to be had: the ones that started do the work.
    }
    work();
    for (auto& thread : team) thread.join();
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
