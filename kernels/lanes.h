// Keywords that let every compiler vectorize a loop.
#pragma once

#include "prefetch.h"

#if defined(_MSC_VER) && !defined(__clang__)
#define FINGERFLOW_RESTRICT __restrict
#define FINGERFLOW_INDEPENDENT __pragma(loop(ivdep))
#elif defined(__clang__)
#define FINGERFLOW_RESTRICT __restrict__
#define FINGERFLOW_INDEPENDENT _Pragma("clang loop vectorize(assume_safety)")
#else
#define FINGERFLOW_RESTRICT __restrict__
#define FINGERFLOW_INDEPENDENT _Pragma("GCC ivdep")
#endif
