/* The operations with AVX-512 in full width; see level_avx2.c. */
#include <stdint.h>
#include <string.h>
#define LEVEL avx512
#define WIDTH 8
#if defined(__x86_64__) && defined(__clang__)
#pragma clang attribute push( \
    __attribute__((target("avx2,avx512f,avx512dq,avx512vl,avx512bw"))), apply_to = function)
#elif defined(__x86_64__) && defined(__GNUC__)
#pragma GCC target("avx2,avx512f,avx512dq,avx512vl,avx512bw,prefer-vector-width=512")
#endif
#include "level.h"
#if defined(__x86_64__) && defined(__clang__)
#pragma clang attribute pop
#endif
