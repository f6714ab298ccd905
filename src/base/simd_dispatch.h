// simd_dispatch.h - hot loops for the machine at hand. The program is compiled for every x86-64 (or arm64); a function
// marked so is compiled once more for x86-64-v3 (AVX2), and the loader of the program chooses. Both give the same bits:
// -ffp-contract=off holds for each, and vectors compute what scalars do. What the function calls is inlined where its
// body is seen: what is not stays as it is. Not for virtual functions, which g++ cannot dispatch.
//
// Each such function is noexcept, allocates nothing and calls nothing that throws: g++ 12 takes a call of a dispatched
// function for one that cannot throw, so that an exception on its way out of it would destroy what its caller does not
// have, or end the program (rooms_test looks for the word).
#pragma once

// The sanitizers' run-time libraries are not yet there when the loader chooses.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__AVX2__) && !defined(RELIEVO_SANITIZED)
#define RELIEVO_SIMD_CLONES __attribute__((target_clones("default", "arch=x86-64-v3"), flatten))
#else
#define RELIEVO_SIMD_CLONES
#endif
