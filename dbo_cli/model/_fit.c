/* The two loops in which an identification spends its time.
 * Every sum is taken in one fixed order, so that neither the number of threads nor the library changes a bit. */
#include "_kernel.h"

#include <math.h>
#include <string.h>

/* Sums that stay in registers: so many rows by so many columns of the matrix. Of 1 to 8 by 4 to 16 the fastest: 256 rows
 * of 90 columns in 80 us; 4 by 12 takes 91, 2 by 8 104, 8 by 8 316 (gcc, AVX2). */
#define HIGH 4
#define WIDE 8
#define ROWS ((size_t)256) /* at once: 200 KB of a table, which stay near the processor */

/* Wider registers where the processor has them: more sums side by side, each in the same order, so the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define FOR_EACH_PROCESSOR __attribute__((target_clones("avx2", "default")))
#else
#define FOR_EACH_PROCESSOR
#endif

enum { AT_ZERO = 0, POSITIVE = 1, FREE = 2, ABSENT = 3 };

/* List the rows in which one of the columns from `first` to `last` is not zero; returns how many, and ends with NULL. */
static size_t nonzero_rows(const double *table, size_t rows, size_t columns, size_t first, size_t last, const double **list) {
    size_t count = 0;
    for (size_t k = 0; k < rows; k++, table += columns) {
        int any = 0;
        for (size_t i = first; i < last; i++) any |= table[i] != 0.0;
        list[count] = table;
        count += any != 0;
    }
    list[count] = NULL;
    return count;
}

/* Add the products of HIGH columns from i on with WIDE columns from j on, over the rows of a list, and keep those from
 * column `low` and `left` of these on. (A loop of known length would be made parallel by row, with loads from all over;
 * one that ends with NULL keeps its sums in registers.) */
FOR_EACH_PROCESSOR
static void add_block(const double *const *list, size_t i, size_t j, size_t low, size_t left, double *matrix, size_t columns) {
    double sum[HIGH][WIDE], all[HIGH][WIDE];
    for (size_t a = 0; a < HIGH; a++) memcpy(sum[a], matrix + (i + a) * columns + j, sizeof sum[a]);
    for (; *list; list++)
        for (size_t a = 0; a < HIGH; a++)
            for (size_t b = 0; b < WIDE; b++) sum[a][b] += (*list)[i + a] * (*list)[j + b];
    memcpy(all, sum, sizeof sum);
    for (size_t a = low; a < HIGH; a++) memcpy(matrix + (i + a) * columns + j + left, all[a] + left, (WIDE - left) * sizeof(double));
}

/* The same for few columns, one by one. */
static void add_few(const double *table, size_t rows, size_t columns, double *matrix) {
    for (size_t k = 0; k < rows; k++, table += columns)
        for (size_t i = 0; i < columns; i++)
            for (size_t j = i; j < columns; j++) matrix[i * columns + j] += table[i] * table[j];
}

/* Add the products of all pairs of columns of a table to the upper triangle of a matrix, row after row.
 * Gears that are not crossed and hats elsewhere are zero in long runs of rows: these add nothing, and are passed over.
 * The last columns are taken with some before them, to make up a whole block.
 * `lists` has room for ROWS + 1 rows, and `counts` for a number, for each WIDE columns. */
static void add_products(const double *table, size_t rows, size_t columns, double *matrix, const double **lists,
                         size_t *counts) {
    const size_t groups = (columns + WIDE - 1) / WIDE;
    for (size_t some; rows; table += some * columns, rows -= some) {
        some = rows < ROWS ? rows : ROWS;
        for (size_t g = 0; g < groups; g++) {
            const size_t last = g + 1 < groups ? (g + 1) * WIDE : columns;
            counts[g] = nonzero_rows(table, some, columns, g * WIDE, last, lists + g * (ROWS + 1));
        }
        for (size_t i = 0; i < columns; i += HIGH) {
            const size_t mine = i / WIDE, from = i + HIGH > columns ? columns - HIGH : i;
            for (size_t g = mine; g < groups; g++) {
                const size_t j = g * WIDE, at = j + WIDE > columns ? columns - WIDE : j;
                const size_t fewer = counts[g] < counts[mine] ? g : mine;
                add_block(lists + fewer * (ROWS + 1), from, at, i - from, j - at, matrix, columns);
            }
        }
    }
}

/* Take the products of the rows above off HIGH rows from i on, in WIDE columns from k on; `above` counts those rows. */
FOR_EACH_PROCESSOR
static void take_rows_off(double *upper, size_t stride, size_t above, size_t i, size_t k) {
    double left[HIGH][WIDE];
    const double *row = upper, *const end = upper + above * stride;
    for (size_t a = 0; a < HIGH; a++) memcpy(left[a], upper + (i + a) * stride + k, sizeof left[a]);
    for (; row != end; row += stride)
        for (size_t a = 0; a < HIGH; a++)
            for (size_t b = 0; b < WIDE; b++) left[a][b] -= row[i + a] * row[k + b];
    for (size_t a = 0; a < HIGH; a++) memcpy(upper + (i + a) * stride + k, left[a], sizeof left[a]);
}

/* Make Cholesky's factor of the upper triangle, in place; 0 where the matrix is not positive definite. Rows are taken HIGH
 * at a time: first what the rows above take off them, then what they take off each other. `stride` is a multiple of WIDE. */
FOR_EACH_PROCESSOR
static int factorise(double *upper, size_t stride, size_t count) {
    for (size_t i = 0; i < count; i += HIGH) {
        const size_t end = i + HIGH < count ? i + HIGH : count;
        for (size_t k = i / WIDE * WIDE; k < stride; k += WIDE) take_rows_off(upper, stride, i, i, k);
        for (size_t j = i; j < end; j++) {
            double *row = upper + j * stride;
            if (!(row[j] > 0.0)) return 0;
            const double root = sqrt(row[j]);
            row[j] = root;
            for (size_t k = j + 1; k < count; k++) row[k] /= root;
            for (size_t below = j + 1; below < end; below++) {
                double *other = upper + below * stride;
                for (size_t k = below; k < count; k++) other[k] -= row[below] * row[k];
            }
        }
    }
    return 1;
}

/* Solve the equations of the unknowns listed in `at`; 0 where the matrix is not positive definite. `upper` has room for
 * `count` rows and columns, both made up to a multiple of WIDE. */
static int solve_passive(const double *matrix, const double *right, size_t n, const size_t *at, size_t count, double *upper,
                         double *x) {
    const size_t stride = (count + WIDE - 1) / WIDE * WIDE;
    memset(upper, 0, stride * stride * sizeof(double));
    for (size_t i = 0; i < count; i++) {
        for (size_t j = i; j < count; j++) upper[i * stride + j] = matrix[at[i] * n + at[j]];
        x[i] = right[at[i]];
    }
    if (!factorise(upper, stride, count)) return 0;
    for (size_t j = 0; j < count; j++) {
        const double *row = upper + j * stride;
        x[j] /= row[j];
        for (size_t k = j + 1; k < count; k++) x[k] -= row[k] * x[j];
    }
    for (size_t j = count; j-- > 0;) {
        x[j] /= upper[j * stride + j];
        for (size_t i = 0; i < j; i++) x[i] -= upper[i * stride + j] * x[j];
    }
    return 1;
}

/* What the unknowns of the solved equations are, and the gradient of the others. */
static void spread(const double *matrix, const double *right, size_t n, const size_t *at, size_t count, const double *part,
                   double *x, double *dual) {
    for (size_t i = 0; i < n; i++) x[i] = 0.0, dual[i] = -right[i];
    for (size_t k = 0; k < count; k++) {
        const double *row = matrix + at[k] * n, value = part[k];
        x[at[k]] = value;
        for (size_t i = 0; i < n; i++) dual[i] += row[i] * value;
    }
}

/* Go from x >= 0 towards the solution `part` until the first unknowns reach zero, and keep these there. */
static void go_to_bound(unsigned char *state, const size_t *at, size_t count, const double *part, double *x) {
    double share = 1.0;
    for (size_t k = 0; k < count; k++) {
        const double here = x[at[k]];
        if (state[at[k]] == POSITIVE && part[k] < 0.0 && here < share * (here - part[k])) share = here / (here - part[k]);
    }
    for (size_t k = 0; k < count; k++) {
        const size_t i = at[k];
        const int reached = state[i] == POSITIVE && part[k] < 0.0 && x[i] <= share * (x[i] - part[k]);
        x[i] += share * (part[k] - x[i]);
        if (reached) x[i] = 0.0, state[i] = AT_ZERO;
    }
}

/* Minimise x'Hx - 2 g'x with x >= 0 but for free unknowns. Block principal pivoting first: unknowns that break their sign or
 * their gradient change sides, all at once while that helps. Then Lawson and Hanson's way, which goes down with every step.
 * Returns the number of steps, 0 where it does not end, -1 where H is not positive definite. */
static long minimise(const double *matrix, const double *right, size_t n, unsigned char *state, double *x, double tolerance,
                     long most, size_t *at, double *upper, double *part, double *dual) {
    size_t fewest = n + 1;
    int patience = 3;
    for (long step = 1; step <= most; step++) {
        size_t count = 0, negative = 0, wrong = 0, steepest = n;
        for (size_t i = 0; i < n; i++)
            if (state[i] == POSITIVE || state[i] == FREE) at[count++] = i;
        if (!solve_passive(matrix, right, n, at, count, upper, part)) return -1;
        for (size_t k = 0; k < count; k++)
            if (state[at[k]] == POSITIVE && part[k] < 0.0) negative++;
        if (patience < 0 && negative) {
            go_to_bound(state, at, count, part, x);
            continue;
        }
        spread(matrix, right, n, at, count, part, x, dual);
        for (size_t i = 0; i < n; i++)
            if (state[i] == AT_ZERO && dual[i] < -tolerance) {
                wrong++;
                if (steepest == n || dual[i] < dual[steepest]) steepest = i;
            }
        if (!negative && !wrong) return step;
        if (patience < 0) {
            state[steepest] = POSITIVE;
            continue;
        }
        if (negative + wrong < fewest) fewest = negative + wrong, patience = 3;
        else patience--;
        for (size_t i = 0; i < n; i++) {
            if (state[i] == POSITIVE && x[i] < 0.0) x[i] = 0.0, state[i] = AT_ZERO;
            else if (patience >= 0 && state[i] == AT_ZERO && dual[i] < -tolerance) state[i] = POSITIVE;
        }
    }
    return 0;
}

PyObject *fit_add_products(PyObject *module, PyObject *args) {
    Py_buffer table, matrix;
    Py_ssize_t columns;
    int fits;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*nw*", &table, &columns, &matrix)) return NULL;
    fits = columns > 0 && NUMBERS(matrix) == (size_t)columns * (size_t)columns && NUMBERS(table) % (size_t)columns == 0;
    const size_t groups = fits ? ((size_t)columns + WIDE - 1) / WIDE : 0;
    const double **lists = fits ? PyMem_Malloc(groups * (ROWS + 1) * sizeof *lists) : NULL;
    size_t *counts = fits ? PyMem_Malloc(groups * sizeof *counts) : NULL;
    if (lists && counts) {
        Py_BEGIN_ALLOW_THREADS
        const size_t rows = NUMBERS(table) / (size_t)columns;
        if (columns < WIDE) add_few(table.buf, rows, (size_t)columns, matrix.buf);
        else add_products(table.buf, rows, (size_t)columns, matrix.buf, lists, counts);
        Py_END_ALLOW_THREADS
    }
    const int lacking = fits && !(lists && counts);
    PyMem_Free(lists);
    PyMem_Free(counts);
    PyBuffer_Release(&table);
    PyBuffer_Release(&matrix);
    if (lacking) return PyErr_NoMemory();
    if (!fits) return PyErr_Format(PyExc_ValueError, "buffer of the wrong length: products");
    Py_RETURN_NONE;
}

PyObject *fit_minimise(PyObject *module, PyObject *args) {
    Py_buffer matrix, right, state, x;
    double tolerance;
    long most, steps = 0;
    int fits;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*w*w*dl", &matrix, &right, &state, &x, &tolerance, &most)) return NULL;
    const size_t n = NUMBERS(right);
    fits = NUMBERS(matrix) == n * n && (size_t)state.len == n && NUMBERS(x) == n;
    const size_t square = (n + WIDE) * (n + WIDE);
    double *room = fits ? PyMem_Malloc((square + 2 * n) * sizeof(double) + n * sizeof(size_t)) : NULL;
    if (room) {
        double *part = room + square, *dual = part + n;
        Py_BEGIN_ALLOW_THREADS
        steps = minimise(matrix.buf, right.buf, n, state.buf, x.buf, tolerance, most, (size_t *)(dual + n), room, part, dual);
        Py_END_ALLOW_THREADS
    }
    const int lacking = fits && !room;
    PyMem_Free(room);
    PyBuffer_Release(&matrix);
    PyBuffer_Release(&right);
    PyBuffer_Release(&state);
    PyBuffer_Release(&x);
    if (lacking) return PyErr_NoMemory();
    if (!fits) return PyErr_Format(PyExc_ValueError, "buffer of the wrong length: minimise");
    return PyLong_FromLong(steps);
}
