/* A signal between its samples in counts: dbo_interpolation.h for even steps, in whole numbers of 64 bits. */
#ifndef DBO_Q31_INTERPOLATION_H
#define DBO_Q31_INTERPOLATION_H

#include <stdint.h>

#include "dbo_q31.h"

#define DBOQ_WINDOW 6 /* samples that a value between two samples is made of */

/* The number of two that is nearer to zero; zero where their signs differ. */
static inline int64_t dboq_nearer(int64_t a, int64_t b) {
    if (a > 0 && b > 0) return a < b ? a : b;
    if (a < 0 && b < 0) return a > b ? a : b;
    return 0;
}

/* The slope at sample a of six, limited: counts a step. */
static inline int64_t dboq_slope(const int32_t *y, int a) {
    /* Twelve times the slope of the polynomial through five samples at each of them. */
    static const int8_t weights[5][5] = {
        {-25, 48, -36, 16, -3}, {-3, -10, 18, -6, 1}, {1, -8, 0, 8, -1}, {-1, 6, -18, 10, 3}, {3, -16, 36, -48, 25}};
    const int last = DBOQ_WINDOW - 1;
    const int s = a < 3 ? 0 : 1;
    int64_t secant[DBOQ_WINDOW - 1], curve[DBOQ_WINDOW - 2]; /* curve[i]: the second difference around sample i + 1 */
    int64_t slope = 0, left = 0, right = 0, chord, parabola, low = 0, high = 0;
    for (int i = 0; i < 5; i++) slope += (int64_t)weights[a - s][i] * y[s + i];
    for (int i = 0; i < last; i++) secant[i] = (int64_t)y[i + 1] - y[i];
    for (int i = 0; i + 1 < last; i++) curve[i] = secant[i + 1] - secant[i];
    if (a > 0) {
        const int64_t before = a > 1 ? curve[a - 2] : curve[a - 1];
        const int64_t here = a < last ? curve[a - 1] : before;
        left = 2 * secant[a - 1] + dboq_nearer(before, here);
    }
    if (a < last) {
        const int64_t after = a < last - 1 ? curve[a] : curve[a - 1];
        const int64_t here = a > 0 ? curve[a - 1] : after;
        right = 2 * secant[a] - dboq_nearer(here, after);
    }
    if (a == 0) {
        chord = secant[0];
        parabola = right;
    } else if (a == last) {
        chord = secant[last - 1];
        parabola = left;
    } else {
        chord = dboq_nearer(secant[a - 1], secant[a]);
        parabola = dboq_nearer(left, right);
    }
    chord *= 36;   /* three times the chord, twelvefold */
    parabola *= 9; /* one and a half times half of it, twelvefold */
    if (chord < low) low = chord;
    if (parabola < low) low = parabola;
    if (chord > high) high = chord;
    if (parabola > high) high = parabola;
    if (slope < low) slope = low;
    if (slope > high) slope = high;
    return slope < 0 ? (slope - 6) / 12 : (slope + 6) / 12;
}

/* value / 2^26, rounded to nearest, halves up. */
static inline int64_t dboq_from_parts(int64_t value) {
    const int64_t one = (int64_t)1 << 26, raised = value + one / 2;
    return raised >= 0 ? raised / one : -((one - 1 - raised) / one);
}

/* The signal the part / 2^26 of a step behind sample k of six. */
static inline int32_t dboq_between(const int32_t *y, int k, int32_t part) {
    const int64_t one = (int64_t)1 << 26, rest = one - part, rise = (int64_t)y[k + 1] - y[k];
    const int64_t begins = dboq_slope(y, k) - rise, ends = dboq_slope(y, k + 1) - rise;
    const int64_t bend = dboq_from_parts(rest * dboq_from_parts(rest * begins - part * ends));
    return dboq_counts_of(y[k] * one + part * (rise + bend), 26U);
}

#endif
