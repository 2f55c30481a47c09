/* The competitor: the inverse Prandtl-Ishlinskii operator of N plays, y = sum w_i r_i with
 * r_i = max(x - h_i, min(x + h_i, r_i)), in the same three arithmetics. */
#include <stdint.h>

#if PLAYS == 1
typedef double number_type;
#elif PLAYS == 2
typedef float number_type;
#else
typedef int32_t number_type;
#endif

typedef struct {
    number_type held[N];
} x_state;

extern const number_type thresholds[N], weights[N];

static void x_init(x_state *s) {
    for (unsigned i = 0; i < N; i++) s->held[i] = 0;
}

__attribute__((noinline)) static number_type x_step(x_state *s, number_type x) {
#if PLAYS == 3
    int64_t sum = 0;
#else
    number_type sum = 0;
#endif
    for (unsigned i = 0; i < N; i++) {
        const number_type low = x - thresholds[i], high = x + thresholds[i];
        number_type r = s->held[i];
        r = r > high ? high : r;
        r = r < low ? low : r;
        s->held[i] = r;
#if PLAYS == 3
        sum += (int64_t)weights[i] * r;
#else
        sum += weights[i] * r;
#endif
    }
#if PLAYS == 3
    return (int32_t)(sum / (1 << 30));
#else
    return sum;
#endif
}
