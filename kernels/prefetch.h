// Prefetch of the cache line at an address, which need not be valid.
#pragma once

#if defined(__GNUC__) || defined(__clang__)
#define FINGERFLOW_PREFETCH(address) __builtin_prefetch(address)
#else
#define FINGERFLOW_PREFETCH(address)
#endif
