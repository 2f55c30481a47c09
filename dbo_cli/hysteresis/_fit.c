/* The two loops in which an identification spends its time, for normal_equations.py, which has the same in Python.
 * Every sum is taken in one fixed order, so that neither the number of threads nor the library changes a bit. */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <string.h>

/* Sums that stay in registers: so many rows by so many columns of the matrix. Of 1 to 8 by 4 to 16 the fastest: 256 rows
 * of 90 columns in 80 us; 4 by 12 takes 91, 2 by 8 104, 8 by 8 316 (gcc, AVX2). */
#define HIGH 4
#define WIDE 8

/* Wider registers where the processor has them: more sums side by side, each in the same order, so the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define FOR_EACH_PROCESSOR __attribute__((target_clones("avx2", "default")))
#else
#define FOR_EACH_PROCESSOR
#endif
#define NUMBERS(view) ((size_t)(view).len / sizeof(double))

enum { AT_ZERO = 0, POSITIVE = 1, FREE = 2, ABSENT = 3 };

/* Add the products of all pairs of columns of a table to the upper triangle of a matrix, row after row. */
FOR_EACH_PROCESSOR
static void add_products(const double *table, size_t rows, size_t columns, double *matrix) {
    for (size_t i = 0; i < columns; i += HIGH) {
        const size_t high = columns - i < HIGH ? columns - i : HIGH;
        for (size_t j = i; j < columns; j += WIDE) {
            const size_t wide = columns - j < WIDE ? columns - j : WIDE;
            double sum[HIGH][WIDE] = {{0.0}};
            const double *left = table + i, *right = table + j;
            for (size_t a = 0; a < high; a++)
                memcpy(sum[a], matrix + (i + a) * columns + j, wide * sizeof(double));
            if (high == HIGH && wide == WIDE) {
                for (size_t k = 0; k < rows; k++, left += columns, right += columns)
                    for (size_t a = 0; a < HIGH; a++)
                        for (size_t b = 0; b < WIDE; b++) sum[a][b] += left[a] * right[b];
            } else {
                for (size_t k = 0; k < rows; k++, left += columns, right += columns)
                    for (size_t a = 0; a < high; a++)
                        for (size_t b = 0; b < wide; b++) sum[a][b] += left[a] * right[b];
            }
            for (size_t a = 0; a < high; a++)
                memcpy(matrix + (i + a) * columns + j, sum[a], wide * sizeof(double));
        }
    }
}

/* Solve the equations of the unknowns listed in `at`; 0 where the matrix is not positive definite. */
FOR_EACH_PROCESSOR
static int solve_passive(const double *matrix, const double *right, size_t n, const size_t *at, size_t count, double *upper,
                         double *x) {
    for (size_t i = 0; i < count; i++) {
        for (size_t j = i; j < count; j++) upper[i * count + j] = matrix[at[i] * n + at[j]];
        x[i] = right[at[i]];
    }
    for (size_t j = 0; j < count; j++) {
        double *row = upper + j * count;
        if (!(row[j] > 0.0)) return 0;
        const double root = sqrt(row[j]);
        row[j] = root;
        for (size_t k = j + 1; k < count; k++) row[k] /= root;
        for (size_t i = j + 1; i < count; i++) {
            const double factor = row[i];
            double *other = upper + i * count;
            if (factor != 0.0)
                for (size_t k = i; k < count; k++) other[k] -= factor * row[k];
        }
        x[j] /= root;
        for (size_t k = j + 1; k < count; k++) x[k] -= row[k] * x[j];
    }
    for (size_t j = count; j-- > 0;) {
        x[j] /= upper[j * count + j];
        for (size_t i = 0; i < j; i++) x[i] -= upper[i * count + j] * x[j];
    }
    return 1;
}

/* Minimise x'Hx - 2 g'x with x >= 0 but for free unknowns, by block principal pivoting (see normal_equations.py).
 * Returns the number of steps, 0 where it does not end, -1 where H is not positive definite. */
static long minimise(const double *matrix, const double *right, size_t n, unsigned char *state, double *x, double tolerance,
                     long most, size_t *at, double *upper, double *part, double *dual) {
    size_t fewest = n + 1;
    int patience = 3;
    for (long step = 1; step <= most; step++) {
        size_t count = 0, wrong = 0, last = 0;
        for (size_t i = 0; i < n; i++)
            if (state[i] == POSITIVE || state[i] == FREE) at[count++] = i;
        if (!solve_passive(matrix, right, n, at, count, upper, part)) return -1;
        for (size_t i = 0; i < n; i++) x[i] = 0.0, dual[i] = -right[i];
        for (size_t k = 0; k < count; k++) {
            const double *row = matrix + at[k] * n, value = part[k];
            x[at[k]] = value;
            for (size_t i = 0; i < n; i++) dual[i] += row[i] * value;
        }
        for (size_t i = 0; i < n; i++)
            if ((state[i] == POSITIVE && x[i] < 0.0) || (state[i] == AT_ZERO && dual[i] < -tolerance)) wrong++, last = i;
        if (!wrong) return step;
        if (wrong < fewest) fewest = wrong, patience = 3;
        else patience--;
        for (size_t i = 0; i < n; i++)
            if (patience >= 0 || i == last) {
                if (state[i] == POSITIVE && x[i] < 0.0) state[i] = AT_ZERO;
                else if (state[i] == AT_ZERO && dual[i] < -tolerance) state[i] = POSITIVE;
            }
    }
    return 0;
}

static PyObject *fit_add_products(PyObject *module, PyObject *args) {
    Py_buffer table, matrix;
    Py_ssize_t columns;
    int fits;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*nw*", &table, &columns, &matrix)) return NULL;
    fits = columns > 0 && NUMBERS(matrix) == (size_t)columns * (size_t)columns && NUMBERS(table) % (size_t)columns == 0;
    if (fits) {
        Py_BEGIN_ALLOW_THREADS
        add_products(table.buf, NUMBERS(table) / (size_t)columns, (size_t)columns, matrix.buf);
        Py_END_ALLOW_THREADS
    }
    PyBuffer_Release(&table);
    PyBuffer_Release(&matrix);
    if (!fits) return PyErr_Format(PyExc_ValueError, "buffer of the wrong length: products");
    Py_RETURN_NONE;
}

static PyObject *fit_minimise(PyObject *module, PyObject *args) {
    Py_buffer matrix, right, state, x;
    double tolerance;
    long most, steps = 0;
    int fits;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*w*w*dl", &matrix, &right, &state, &x, &tolerance, &most)) return NULL;
    const size_t n = NUMBERS(right);
    fits = NUMBERS(matrix) == n * n && (size_t)state.len == n && NUMBERS(x) == n;
    double *room = fits ? PyMem_Malloc((n * n + 2 * n) * sizeof(double) + n * sizeof(size_t) + 1) : NULL;
    if (room) {
        Py_BEGIN_ALLOW_THREADS
        steps = minimise(matrix.buf, right.buf, n, state.buf, x.buf, tolerance, most, (size_t *)(room + n * n + 2 * n), room,
                         room + n * n, room + n * n + n);
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

static PyMethodDef methods[] = {
    {"add_products", fit_add_products, METH_VARARGS, "add_products(table, columns, matrix)"},
    {"minimise", fit_minimise, METH_VARARGS, "minimise(matrix, right, state, x, tolerance, most) -> steps"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_fit", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__fit(void) { return PyModule_Create(&definition); }
