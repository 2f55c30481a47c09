/* A signal between its samples: a cubic with limited slopes, from six samples. C99, no library.
 *
 * The slope at a sample is that of the polynomial through five samples, and is limited as in H. T. Huynh, "Accurate
 * Monotone Cubic Interpolation", SIAM J. Numer. Anal. 30 (1993), scheme M3-A: where the samples rise, what is between
 * them rises; a turn lies between two samples only where the second differences on both sides agree that there is one.
 */
#ifndef DBO_INTERPOLATION_H
#define DBO_INTERPOLATION_H

#define DBO_WINDOW 6 /* samples that a value between two samples is made of */

/* The number of two that is nearer to zero; zero where their signs differ. */
static inline double dbo_nearer(double a, double b) {
    if (a > 0.0 && b > 0.0) return a < b ? a : b;
    if (a < 0.0 && b < 0.0) return a > b ? a : b;
    return 0.0;
}

/* The slope at sample a of the polynomial through the five samples from sample s on, in Newton's form.
 * Row k of the table has the divided differences of order k, the first of them at the first sample. */
static inline double dbo_slope_of_five(const double *t, double (*table)[DBO_WINDOW], int s, int a) {
    double value = table[4][s], slope = 0.0;
    for (int i = 3; i >= 0; i--) {
        const double gone = t[a] - t[s + i];
        slope = slope * gone + value;
        value = value * gone + table[i][s];
    }
    return slope;
}

/* The slope at sample a of six, limited. */
static inline double dbo_slope(const double *t, double (*table)[DBO_WINDOW], int a) {
    const double *secant = table[1], *curve = table[2]; /* curve[i] is that around sample i + 1 */
    const int last = DBO_WINDOW - 1;
    const int s = a < 3 ? 0 : 1;
    const double slope = dbo_slope_of_five(t, table, s, a);
    double left = 0.0, right = 0.0, chord, parabola, low = 0.0, high = 0.0;
    if (a > 0) {
        const double before = a > 1 ? curve[a - 2] : curve[a - 1];
        const double here = a < last ? curve[a - 1] : before;
        left = secant[a - 1] + dbo_nearer(before, here) * (t[a] - t[a - 1]);
    }
    if (a < last) {
        const double after = a < last - 1 ? curve[a] : curve[a - 1];
        const double here = a > 0 ? curve[a - 1] : after;
        right = secant[a] - dbo_nearer(here, after) * (t[a + 1] - t[a]);
    }
    if (a == 0) {
        chord = secant[0];
        parabola = right;
    } else if (a == last) {
        chord = secant[last - 1];
        parabola = left;
    } else {
        chord = dbo_nearer(secant[a - 1], secant[a]);
        parabola = dbo_nearer(left, right);
    }
    chord *= 3.0;
    parabola *= 1.5;
    if (chord < low) low = chord;
    if (parabola < low) low = parabola;
    if (chord > high) high = chord;
    if (parabola > high) high = parabola;
    if (slope < low) return low;
    if (slope > high) return high;
    return slope;
}

/* The signal the part p (0 to 1) of a step behind sample k of six, whose times rise. */
static inline double dbo_between(const double *t, const double *y, int k, double p) {
    double table[5][DBO_WINDOW];
    for (int i = 0; i < DBO_WINDOW; i++) table[0][i] = y[i];
    for (int order = 1; order < 5; order++)
        for (int i = 0; i + order < DBO_WINDOW; i++)
            table[order][i] = (table[order - 1][i + 1] - table[order - 1][i]) / (t[i + order] - t[i]);
    const double step = t[k + 1] - t[k], rise = y[k + 1] - y[k];
    const double begins = dbo_slope(t, table, k) * step - rise;
    const double ends = dbo_slope(t, table, k + 1) * step - rise;
    const double rest = 1.0 - p;
    return y[k] + p * (rise + rest * (rest * begins - p * ends));
}

#endif
