// Prefetch of the cache line at an address, which need not be valid, into the second cache: the first is too small for
// what is to come, and has fewer places for lines on their way.
#pragma once

#if defined(__GNUC__) || defined(__clang__)
#define FINGERFLOW_PREFETCH(address) __builtin_prefetch(reinterpret_cast<const void*>(address), 0, 2)
#else
#define FINGERFLOW_PREFETCH(address)
#endif
