/* The competitor: the Prandtl-Ishlinskii operator, a weighted sum of n play operators,
 *     r_i = max(x - h_i, min(x + h_i, r_i)),   y = sum w_i r_i,
 * written in every layout that seemed worth trying; kernel_speed.py compiles this for the machine it runs
 * on, with fast-math and all, and takes the fastest for each n.
 *
 * `plain` leaves everything to the compiler. The others keep the plays in vector lanes and their state,
 * thresholds and weights in registers while a stretch of samples goes by: LANES doubles a vector, GROUP
 * vectors at a time; the partial sums of a stretch stay in the first-level cache.
 * Arrays are padded to a multiple of LANES * GROUP with weights 0.
 */
#include <cstddef>
using std::size_t;

extern "C" void plain(const double *h, const double *w, double *r, size_t n, const double *x, double *y, size_t count) {
    for (size_t k = 0; k < count; k++) {
        const double v = x[k];
        double sum = 0.0;
        for (size_t i = 0; i < n; i++) {
            const double low = v - h[i], high = v + h[i];
            double s = r[i];
            s = s > high ? high : s;
            s = s < low ? low : s;
            r[i] = s;
            sum += w[i] * s;
        }
        y[k] = sum;
    }
}

#define STRETCH 256

#define LAYOUT(NAME, LANES, GROUP)                                                                         \
    typedef double NAME##_vector __attribute__((vector_size(8 * LANES), aligned(8), may_alias));           \
    extern "C" void NAME(const double *h, const double *w, double *r, size_t n, const double *x, double *y,           \
              size_t count) {                                                                              \
        typedef NAME##_vector vector;                                                                      \
        for (size_t begin = 0; begin < count; begin += STRETCH) {                                          \
            const size_t length = count - begin < STRETCH ? count - begin : STRETCH;                       \
            vector sum[STRETCH];                                                                           \
            for (size_t i = 0; i < n; i += LANES * GROUP) {                                                \
                vector s[GROUP], a[GROUP], b[GROUP];                                                       \
                for (int g = 0; g < GROUP; g++) {                                                          \
                    s[g] = *(const vector *)(r + i + LANES * g);                                           \
                    a[g] = *(const vector *)(h + i + LANES * g);                                           \
                    b[g] = *(const vector *)(w + i + LANES * g);                                           \
                }                                                                                          \
                for (size_t k = 0; k < length; k++) {                                                      \
                    const double v = x[begin + k];                                                         \
                    vector part = i ? sum[k] : vector{};                                                \
                    for (int g = 0; g < GROUP; g++) {                                                      \
                        const vector low = v - a[g], high = v + a[g];                                      \
                        s[g] = s[g] > high ? high : s[g];                                                  \
                        s[g] = s[g] < low ? low : s[g];                                                    \
                        part += b[g] * s[g];                                                               \
                    }                                                                                      \
                    sum[k] = part;                                                                         \
                }                                                                                          \
                for (int g = 0; g < GROUP; g++) *(vector *)(r + i + LANES * g) = s[g];                     \
            }                                                                                              \
            for (size_t k = 0; k < length; k++) {                                                          \
                double total = 0.0;                                                                        \
                for (int j = 0; j < LANES; j++) total += sum[k][j];                                        \
                y[begin + k] = total;                                                                      \
            }                                                                                              \
        }                                                                                                  \
    }

LAYOUT(lanes4x1, 4, 1)
LAYOUT(lanes4x2, 4, 2)
LAYOUT(lanes4x4, 4, 4)
LAYOUT(lanes8x1, 8, 1)
LAYOUT(lanes8x2, 8, 2)
LAYOUT(lanes8x4, 8, 4)
LAYOUT(lanes8x7, 8, 7)
