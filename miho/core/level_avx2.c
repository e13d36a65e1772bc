/* The operations with AVX2. The target is a pragma, so that any builder can compile the file. The
   headers come before it, because their definitions may not have another target. */
#include <stdint.h>
#include <string.h>
#define LEVEL avx2
#define WIDTH 4
#if defined(__x86_64__) && defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#elif defined(__x86_64__) && defined(__GNUC__)
#pragma GCC target("avx2")
#endif
#include "level.h"
#if defined(__x86_64__) && defined(__clang__)
#pragma clang attribute pop
#endif
