/* Written by experiments/check/coefficients.py. */
#define EXP_0 0x1.0000000000001p-1
#define EXP_1 0x1.5555555555556p-3
#define EXP_2 0x1.5555555553d63p-5
#define EXP_3 0x1.11111111109b3p-7
#define EXP_4 0x1.6c16c1788bd90p-10
#define EXP_5 0x1.a01a01a7c41d5p-13
#define EXP_6 0x1.a019b90d2ae7ap-16
#define EXP_7 0x1.71de0dae63bb3p-19
#define EXP_8 0x1.289185613a3d6p-22
#define EXP_9 0x1.af38a9b0ec855p-26
#define LOG_0 0x1.5555555555558p-1
#define LOG_1 0x1.99999999952d7p-2
#define LOG_2 0x1.2492492df281ap-2
#define LOG_3 0x1.c71c62e3f11e6p-3
#define LOG_4 0x1.7462b51cb66b1p-3
#define LOG_5 0x1.39fe51a7c18f9p-3
#define LOG_6 0x1.2b5900de53b32p-3
#define LOG_MORE_0 0x1.999999999999ep-2
#define LOG_MORE_1 0x1.249249248e532p-2
#define LOG_MORE_2 0x1.c71c71d7e7fc3p-3
#define LOG_MORE_3 0x1.745d09f06d811p-3
#define LOG_MORE_4 0x1.3b18b8ee7a308p-3
#define LOG_MORE_5 0x1.1018ae366a914p-3
#define LOG_MORE_6 0x1.08788c3e01713p-3
#define SIN_0 -0x1.5555555555555p-3
#define SIN_1 0x1.1111111110bb2p-7
#define SIN_2 -0x1.a01a019e83816p-13
#define SIN_3 0x1.71de379654304p-19
#define SIN_4 -0x1.ae600aca92c64p-26
#define SIN_5 0x1.5e0b05bff20f2p-33
#define COS_0 0x1.5555555555555p-5
#define COS_1 -0x1.6c16c16c16967p-10
#define COS_2 0x1.a01a019f4e9b4p-16
#define COS_3 -0x1.27e4fa17bf139p-22
#define COS_4 0x1.1eeb68cd22f56p-29
#define COS_5 -0x1.907d8f29fe831p-37
#define ATAN_0 -0x1.5555555555555p-2
#define ATAN_1 0x1.999999999934ap-3
#define ATAN_2 -0x1.24924924360cbp-3
#define ATAN_3 0x1.c71c7185314cbp-4
#define ATAN_4 -0x1.745d0b26b83e7p-4
#define ATAN_5 0x1.3b1262d95579ep-4
#define ATAN_6 -0x1.10fa75382537fp-4
#define ATAN_7 0x1.dfe61e80903d2p-5
#define ATAN_8 -0x1.a098bb6ba4941p-5
#define ATAN_9 0x1.41603647c7a7cp-5
#define ATAN_10 -0x1.3a2b7a07caea9p-6
#define LN2_0 0x1.62e42fee00000p-1
#define LN2_1 0x1.a39ef35793c76p-33
#define LN10_INVERSE_0 0x1.bcb7b1526e50ep-2
#define LN10_INVERSE_1 0x1.95355baaafad3p-57
#define LOG10_OF_2_0 0x1.3441350800000p-2
#define LOG10_OF_2_1 0x1.f79fef311f12bp-34
#define LN2_INVERSE_0 0x1.71547652b82fep+0
#define LN2_INVERSE_1 0x1.777d0ffda0d24p-56
#define LOG_TINY_0 -0x1.cc845b54b54f2p+7
#define LOG_TINY_1 0x1.8ed150b29b629p-47
#define PI_HALF_0 0x1.921fb54442d18p+0
#define PI_HALF_1 0x1.1a62633145c07p-54
#define PI_QUARTER_0 0x1.921fb54442d18p-1
#define PI_QUARTER_1 0x1.1a62633145c07p-55
#define PI_HALF_SHORT_0 0x1.921fb54400000p+0
#define PI_HALF_SHORT_1 0x1.0b4611a600000p-34
#define PI_HALF_SHORT_2 0x1.3198a2e037073p-69
#define TWO_OVER_PI_WORDS 42
#define TWO_OVER_PI \
    0u, 0u, 0xa2f9836eu, 0x4e441529u, 0xfc2757d1u, 0xf534ddc0u, \
    0xdb629599u, 0x3c439041u, 0xfe5163abu, 0xdebbc561u, 0xb7246e3au, 0x424dd2e0u, \
    0x06492eeau, 0x09d1921cu, 0xfe1deb1cu, 0xb129a73eu, 0xe88235f5u, 0x2ebb4484u, \
    0xe99c7026u, 0xb45f7e41u, 0x3991d639u, 0x835339f4u, 0x9c845f8bu, 0xbdf9283bu, \
    0x1ff897ffu, 0xde05980fu, 0xef2f118bu, 0x5a0a6d1fu, 0x6d367ecfu, 0x27cb09b7u, \
    0x4f463f66u, 0x9e5fea2du, 0x7527bac7u, 0xebe5f17bu, 0x3d0739f7u, 0x8a5292eau, \
    0x6bfb5fb1u, 0x1f8d5d08u, 0x56033046u, 0xfc7b6babu, 0xf0cfbc20u, 0x9af4361du
