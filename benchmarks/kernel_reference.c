/* The kernel against the procedure gear by gear, bit for bit, on random operators, states, inputs and cuts.
 *
 *     cc -std=c99 -O3 -ffp-contract=off -Idbo_cli/hysteresis benchmarks/kernel_reference.c -lm -o kernel_reference
 *     ./kernel_reference STEPS SEED
 *
 * Add -DDBO_SMALL for the kernel as chips have it, -DDBO_SPACING=4 for many checkpoints. Every block compares the
 * outputs, the state and the counts, and ends with 1 at the first difference. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "dbo_kernel.c"

#define MOST_GEARS 1300
#define MOST_BLOCK 400
#define TERMS 3

/* ---- random numbers: xorshift ------------------------------------------------------------------------ */

static uint64_t seed;

static uint64_t random_bits(void) {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed;
}

static double uniform(double low, double high) {
    return low + (high - low) * ((double)(random_bits() >> 11) * 0x1p-53);
}

static size_t below(size_t count) { return (size_t)(random_bits() % count); }

/* ---- the reference: one byte a gear, one gear at a time ---------------------------------------------- */

static double dx[MOST_GEARS], dy[MOST_GEARS], fraction[MOST_GEARS];

typedef struct {
    unsigned char bit[MOST_GEARS];
    size_t set, zero;
    double x, y, last, memory[TERMS];
} slow_state;

static size_t lowest(const slow_state *s, size_t n, size_t from, int bit) {
    while (from < n && s->bit[from] != bit) from++;
    return from;
}

static void begin_slow(slow_state *s, size_t n) {
    s->x = s->y = 0.0;
    for (size_t i = 0; i < n; i++) {
        if (!s->bit[i]) continue;
        s->x += dx[i];
        s->y += dy[i];
    }
    s->set = lowest(s, n, 0, 1);
    s->zero = lowest(s, n, 0, 0);
}

static size_t slow_pass(slow_state *s, size_t n, double u, double kappa, double bound, int rising) {
    size_t last = n;
    for (;;) {
        const size_t gear = rising ? s->zero : s->set;
        const double d = u - (s->x + kappa * s->y), travelled = rising ? d : -d;
        const double room = rising ? bound - s->y : s->y - bound;
        if (gear == n) return last;
        if (!(travelled >= (dx[gear] + kappa * dy[gear]) * fraction[gear] && room >= dy[gear] * fraction[gear]))
            return last;
        last = gear;
        s->bit[gear] = (unsigned char)rising;
        s->x += rising ? dx[gear] : -dx[gear];
        s->y += rising ? dy[gear] : -dy[gear];
        s->set = rising ? 0 : lowest(s, n, gear + 1, 1);
        s->zero = rising ? lowest(s, n, gear + 1, 0) : 0;
    }
}

static double slow_solve(const dbo_backlash *op, slow_state *s, double u, double kappa, double low, double high,
                         int *outside) {
    double d = u - (s->x + kappa * s->y), width;
    const int rising = d >= 0.0;
    const size_t n = op->n, last = slow_pass(s, n, u, kappa, rising ? high : low, rising);
    size_t gear = rising ? s->zero : s->set;
    d = u - (s->x + kappa * s->y);
    if (last < n && (rising ? d < 0.0 : d > 0.0)) gear = last;
    width = dx[gear < n ? gear : n - 1] + kappa * dy[gear < n ? gear : n - 1];
    if (gear == n) {
        *outside = (rising ? d : -d) >= width * (1.0 - fraction[n - 1]);
        if (!op->extend) return s->y;
        gear = n - 1;
    }
    return s->y + d * (dy[gear] / width);
}

static void slow_follow(slow_state *s, size_t n, double y, int rising) {
    slow_pass(s, n, rising ? INFINITY : -INFINITY, 0.0, y, rising);
}

static double slow_within(const dbo_backlash *op, slow_state *s, double u, double kappa, double low, double high,
                          double slack, int *outside, int *clipped) {
    const double least = low - op->y0, most = high - op->y0;
    const int rising = u - (s->x + kappa * s->y) >= 0.0;
    double y;
    if (rising ? most < s->y : least > s->y) {
        slow_follow(s, op->n, rising ? most : least, !rising);
        *clipped = 1;
        return rising ? high : low;
    }
    y = op->y0 + slow_solve(op, s, u, kappa, least, most, outside);
    if (y > high) {
        *clipped = y - high > slack;
        if (!rising) slow_follow(s, op->n, most, 0);
        return high;
    }
    if (y < low) {
        *clipped = low - y > slack;
        if (rising) slow_follow(s, op->n, least, 1);
        return low;
    }
    return y;
}

static double slow_step(const dbo_backlash *op, slow_state *s, double x, const double *a, const dbo_limits *limits,
                        size_t k, dbo_counts *counts) {
    const int before = op->terms && op->memory_on_output, after = op->terms && !op->memory_on_output;
    double u = x - op->x0, kappa = 0.0, remembered = 0.0, y;
    int outside = 0, clipped = 0;
    for (size_t j = 0; j < op->terms; j++) {
        if (after) s->memory[j] = a[j] * s->memory[j] + (1.0 - a[j]) * (x - op->reference);
        if (before) s->memory[j] = a[j] * s->memory[j];
        if (before) kappa += op->gain[j] * (1.0 - a[j]);
        remembered += op->gain[j] * s->memory[j];
    }
    if (before) u = (u - remembered) - kappa * (op->y0 - op->reference);
    if (limits) {
        double low = limits->low, high = limits->high;
        if (limits->step && s->last == s->last)
            window(limits, limits->step[k * limits->step_stride], s->last, &low, &high);
        y = slow_within(op, s, u, kappa, low, high, limits->slack, &outside, &clipped);
    } else {
        const double part = slow_solve(op, s, u, kappa, -INFINITY, INFINITY, &outside);
        y = after ? op->y0 + (part + remembered) : op->y0 + part;
    }
    if (outside) note(&counts->outside, &counts->first_outside, k);
    if (clipped) note(&counts->clipped, &counts->first_clipped, k);
    for (size_t j = 0; before && j < op->terms; j++) s->memory[j] += (1.0 - a[j]) * (y - op->reference);
    s->last = y;
    return y;
}

/* ---- random operators -------------------------------------------------------------------------------- */

static dbo_gear table[MOST_GEARS + 1];
static dbo_place guide[2 * MOST_GEARS + 3], turns[MOST_GEARS], fixed_guide[2 * MOST_GEARS + 3];
static dbo_fixed_gear fixed_gears[MOST_GEARS];
static dbo_checkpoint checkpoints[MOST_GEARS / DBO_SPACING];
static double gain[TERMS], rest[TERMS];

/* Onto the grid that makes every sum exact, as operators.py does it; 0 where a width is too narrow for that. */
static int on_grid(double *widths, size_t n) {
    for (;;) {
        double total = 0.0, grid;
        int exponent, same = 1;
        for (size_t i = 0; i < n; i++) total += widths[i];
        total *= 1.0 + 1e-12; /* this sum is rounded: a grid that is coarser does no harm */
        frexp(total, &exponent);
        grid = ldexp(1.0, exponent - 53);
        for (size_t i = 0; i < n; i++) {
            const double rounded = rint(widths[i] / grid) * grid;
            if (rounded < 0x1p-42 * total) return 0;
            same = same && rounded == widths[i];
            widths[i] = rounded;
        }
        if (same) return 1;
    }
}

static double scale_of(double from, double span) {
    const double low = fabs(from), high = fabs(from + span), most = low > high ? low : high;
    return most > span ? most : span;
}

static void make_widths(size_t n, size_t run) {
    const size_t kind = below(5);
    const double tall = pow(10.0, uniform(-3.0, 3.0)), even = uniform(0.1, 2.0);
    do
        for (size_t i = 0; i < n; i++) {
            double width = even, slope = uniform(0.2, 2.0);
            if (kind == 1) width = uniform(0.1, 1.0);
            if (kind == 2) width = exp(uniform(-3.0, 3.0));
            if (kind == 3) width = below(8) == 0 ? pow(2.0, uniform(-28.0, 0.0)) : uniform(0.5, 1.0);
            if (kind == 4) slope = 0.2 + 1.8 * (double)i / (double)n;
            dx[i] = i % run ? dx[i - 1] : width;
            dy[i] = i % run ? dy[i - 1] : tall * width * slope;
        }
    while (!on_grid(dx, n) || !on_grid(dy, n));
}

static void make_operator(dbo_backlash *op) {
    static const size_t sizes[] = {1, 2, 3, 5, 8, 13, 25, 25, 64, 64, 65, 128, 300, 1280};
    const size_t n = sizes[below(sizeof sizes / sizeof *sizes)], run = below(3) ? 1 : 1 + below(n < 70 ? n : 70);
    const size_t rows = (n + run - 1) / run;
    double x = 0.0, y = 0.0, scale_x, scale_y, remembered = 0.0;
    make_widths(n, run);
    for (size_t i = 0; i < n; i++) {
        x += dx[i];
        y += dy[i];
    }
    op->terms = below(2) ? 1 + below(TERMS) : 0;
    op->memory_on_output = (int)below(2);
    op->gain = gain;
    op->reference = uniform(-1.0, 1.0) * (op->memory_on_output ? y : x);
    op->x0 = below(4) ? uniform(-1.0, 1.0) * x : 0.0;
    op->y0 = below(4) ? uniform(-1.0, 1.0) * y : 0.0;
    op->extend = (int)below(3);
    scale_x = scale_of(op->x0, x);
    scale_y = scale_of(op->y0, y);
    for (size_t j = 0; j < op->terms; j++) {
        gain[j] = uniform(0.0, 0.3) * (op->memory_on_output ? x / y : y / x);
        remembered += gain[j];
    }
    remembered *= (op->memory_on_output ? scale_y : scale_x) + fabs(op->reference);
    if (op->terms && op->memory_on_output) scale_x += remembered;
    if (op->terms && !op->memory_on_output) scale_y += remembered;
    op->gears = table;
    op->n = n;
    op->run = run;
    op->row_factor = DBO_ROW_FACTOR(run);
    x = y = 0.0;
    for (size_t i = 0; i <= n; i++) {
        dbo_gear *row = table + (i < n ? i / run : rows);
        if (i < n) {
            const double wide = scale_x / dx[i], high = scale_y / dy[i];
            const double rounding = 64.0 * 0x1p-52 * (wide > high ? wide : high);
            fraction[i] = 1.0 - (rounding < 1e-9 ? 1e-9 : rounding > 1.0 / 16.0 ? 1.0 / 16.0 : rounding);
        }
        if (i == n || i % run == 0) {
            const size_t k = i < n ? i : n - 1;
            const dbo_gear made = {dx[k], dy[k], dy[k] / dx[k], fraction[k], x, y};
            *row = made;
        }
        if (i < n) {
            x += dx[i];
            y += dy[i];
        }
    }
    op->parts = below(2) ? rows : 2 * rows;
    op->parts_per_x = (double)op->parts / table[rows].x;
    for (size_t part = 0, row = 0; part <= op->parts; part++) {
        while (row + 1 < rows && table[row + 1].x <= (double)part / op->parts_per_x) row++;
        guide[part] = (dbo_place)row;
    }
    op->guide = below(3) ? guide : NULL; /* one that misleads changes no bit, either */
    if (below(8) == 0)
        for (size_t part = 0; part <= op->parts; part++) guide[part] = (dbo_place)below(rows);
}

/* ---- random inputs ----------------------------------------------------------------------------------- */

/* Inputs of one kind; those of a forward operator's axis, or what an inverse is asked for. */
static void make_inputs(const dbo_backlash *op, const slow_state *s, double *x, size_t count) {
    const size_t rows = row_of(op, op->n - 1, 1) + 1, kind = below(9);
    const double low = op->x0, span = table[rows].x, phase = uniform(0.0, 6.3), speed = pow(10.0, uniform(-4.0, 0.3));
    double at = low + s->x, swing = 1.0;
    for (size_t k = 0; k < count; k++) {
        const size_t gear = below(op->n + 1);
        const point edge = begin_of(op, gear, 1);
        switch (kind) {
        case 0: x[k] = low + span * (0.5 + 0.5 * cos(phase + speed * (double)k)); break;
        case 1: x[k] = low + span * uniform(-0.05, 1.05); break;
        case 2: x[k] = k % 2 ? low : low + span; break;
        case 3: x[k] = low + edge.x; break;
        case 4: x[k] = nextafter(low + span - edge.x, below(2) ? INFINITY : -INFINITY); break;
        case 5: /* nested turns */
            x[k] = low + span * (0.5 + (k % 2 ? 0.5 : -0.5) * swing);
            swing *= 1.0 - speed / 10.0;
            break;
        case 6: /* breakpoints met on a random walk, exactly or nearly */
            at += (below(2) ? 1.0 : -1.0) * dx[below(op->n)] * (below(3) ? 1.0 : 1.0 + uniform(-2e-9, 2e-9));
            if (at < low - 0.1 * span || at > low + 1.1 * span) at = low + span * uniform(0.0, 1.0);
            x[k] = at;
            break;
        case 7: x[k] = low + span * uniform(-3.0, 3.0); break;
        default: x[k] = below(3) ? low + span * uniform(0.0, 1.0) : below(2) ? low - 1e6 * span : low + 1e9 * span;
        }
    }
}

/* ---- a case: one operator, some blocks --------------------------------------------------------------- */

static void copy_bits(const dbo_backlash *op, const slow_state *s, uint64_t *words) {
    for (size_t k = 0; k < (op->n + 63) / 64; k++) words[k] = 0;
    for (size_t i = 0; i < op->n; i++) words[i / 64] |= (uint64_t)s->bit[i] << (i & 63);
}

static int same_state(const dbo_backlash *op, const dbo_backlash_state *state, const slow_state *s) {
    uint64_t words[MOST_GEARS / 64 + 1], wanted[MOST_GEARS / 64 + 1];
    dbo_backlash_bits(op, state, words);
    copy_bits(op, s, wanted);
    return memcmp(words, wanted, (op->n + 63) / 64 * sizeof *words) == 0 &&
           memcmp(&state->x, &s->x, sizeof s->x) == 0 && memcmp(&state->y, &s->y, sizeof s->y) == 0 &&
           state->set == s->set && state->zero == s->zero && memcmp(&state->last, &s->last, sizeof s->last) == 0 &&
           memcmp(state->memory, s->memory, op->terms * sizeof *s->memory) == 0;
}

static size_t run_case(void) {
    static double x[MOST_BLOCK], y[MOST_BLOCK], wanted[MOST_BLOCK], decay[MOST_BLOCK * TERMS], step[MOST_BLOCK];
    double memory[TERMS], spare_memory[TERMS];
    dbo_backlash op;
    dbo_backlash_state state, planned;
    slow_state s;
    size_t done = 0;
    const size_t mixed = 1 + below(40);
    make_operator(&op);
    memset(&s, 0, sizeof s);
    for (size_t i = 0, bit = 0; i < op.n; i++) {
        if (below(mixed) == 0) bit = !bit;
        s.bit[i] = (unsigned char)bit;
    }
    begin_slow(&s, op.n);
    s.last = below(2) ? NAN : op.y0;
    for (size_t j = 0; j < op.terms; j++) s.memory[j] = uniform(-1.0, 1.0);
    state.turns = turns;
    state.checkpoints = checkpoints;
    state.memory = memory;
    for (size_t blocks = 1 + below(30); blocks > 0; blocks--) {
        const size_t count = 1 + below(MOST_BLOCK), rows = row_of(&op, op.n - 1, 1) + 1;
        const int limited = (!op.terms || op.memory_on_output) && below(2), even = below(3) > 0;
        const double tall = table[rows].y;
        dbo_counts counts = {0, 0, 0, 0}, slow_counts = {0, 0, 0, 0};
        dbo_limits limits = {op.y0 + tall * uniform(-0.2, 0.4), op.y0 + tall * uniform(0.6, 1.2), 1e-9 * tall, NULL, 0};
        uint64_t words[MOST_GEARS / 64 + 1];
        if (below(2)) limits.step = step;
        limits.step_stride = below(2);
        for (size_t k = 0; k < count; k++) step[k] = tall * pow(10.0, uniform(-4.0, 0.0));
        for (size_t k = 0; k < count * TERMS; k++) decay[k] = below(20) ? exp(-pow(10.0, uniform(-5.0, 1.0))) : 0.0;
        make_inputs(&op, &s, x, count);
        if (done == 0 || below(2)) { /* a cut: through the bits, as a file has them */
            copy_bits(&op, &s, words);
            dbo_backlash_load(&op, &state, words);
            memcpy(memory, s.memory, sizeof memory);
            state.last = s.last;
        }
        if (below(4) == 0) { /* a plan that is dropped leaves no trace */
            planned = state;
            planned.memory = spare_memory;
            memcpy(spare_memory, memory, sizeof memory);
            dbo_backlash_step(&op, &planned, x[below(count)], decay, limited ? &limits : NULL, NULL);
        }
        for (size_t k = 0; k < count; k++)
            wanted[k] = slow_step(&op, &s, x[k], decay + (even ? 0 : k * op.terms), limited ? &limits : NULL, k,
                                  &slow_counts);
        if (even && (limited || (op.terms && op.memory_on_output)) && below(2)) {
            const dbo_fixed_step fixed =
                dbo_prepare_fixed_step(&op, decay, rest, fixed_gears, op.guide && below(2) ? fixed_guide : NULL);
            dbo_backlash_run_fixed(&op, &fixed, &state, x, y, count, limited ? &limits : NULL, &counts);
        } else {
            dbo_backlash_run(&op, &state, x, y, count, decay, even ? 0 : op.terms, limited ? &limits : NULL, &counts);
        }
        for (size_t k = 0; k < count; k++)
            if (memcmp(y + k, wanted + k, sizeof *y) != 0) {
                printf("sample %zu of %zu: %a, and %a gear by gear (n = %zu, run %zu, terms %zu, limited %d)\n", k, count,
                       y[k], wanted[k], op.n, op.run, op.terms, limited);
                exit(1);
            }
        if (memcmp(&counts, &slow_counts, sizeof counts) != 0 || !same_state(&op, &state, &s)) {
            printf("after %zu samples: another state or other counts (n = %zu, run %zu, terms %zu, limited %d)\n", count,
                   op.n, op.run, op.terms, limited);
            exit(1);
        }
        if (limited && below(3) == 0) { /* the output was another one */
            const double given = op.y0 + tall * uniform(-0.1, 1.1);
            slow_follow(&s, op.n, given - op.y0, given - op.y0 >= s.y);
            for (size_t j = 0; j < op.terms; j++)
                s.memory[j] = decay[j] * s.memory[j] + (1.0 - decay[j]) * (given - op.reference);
            s.last = given;
            dbo_backlash_apply(&op, &state, given, decay);
        }
        done += count;
    }
    return done;
}

int main(int count, char **arguments) {
    const double wanted = count > 1 ? atof(arguments[1]) : 1e6;
    double done = 0.0;
    seed = UINT64_C(0x9E3779B97F4A7C15) * (uint64_t)(count > 2 ? atoi(arguments[2]) + 1 : 1);
    while (done < wanted) done += (double)run_case();
    printf("%.0f steps, every bit as gear by gear\n", done);
    return 0;
}
