/* dbo_interpolation.h over arrays; delay.py says what the arguments are. */
#include "_kernel.h"

#include "dbo_interpolation.h"

static double at_part(const double *t, const double *v, size_t before, size_t known, double part) {
    size_t begin = before > 2 ? before - 2 : 0;
    int rises = known >= DBO_WINDOW - 1;
    if (rises && begin > known - (DBO_WINDOW - 1)) begin = known - (DBO_WINDOW - 1);
    if (rises && begin + (DBO_WINDOW - 1) > known) rises = 0;
    for (size_t i = 0; rises && i + 1 < DBO_WINDOW; i++) rises = t[begin + i] < t[begin + i + 1];
    if (rises) return dbo_between(t + begin, v + begin, (int)(before - begin), part);
    return v[before] + part * (v[before + 1] - v[before]);
}

PyObject *between(PyObject *module, PyObject *args) {
    Py_buffer times, values, wanted, found;
    double whole;
    Py_ssize_t newest;
    size_t before = 0;
    int ready = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*y*w*nd", &times, &values, &wanted, &found, &newest, &whole)) return NULL;
    const size_t count = NUMBERS(wanted);
    if (NUMBERS(times) == 0 || NUMBERS(values) != NUMBERS(times) || NUMBERS(found) != count || newest < 0) {
        PyErr_SetString(PyExc_ValueError, "arrays of unlike lengths");
        goto done;
    }
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    const double *t = times.buf, *v = values.buf;
    const size_t last = NUMBERS(times) - 1;
    for (size_t k = 0; k < count; k++) {
        const double at = ((const double *)wanted.buf)[k];
        while (before < last && t[before + 1] <= at) before++;
        const size_t after = before < last ? before + 1 : last;
        const double gap = t[after] - t[before];
        const double part = gap > 0.0 ? (at - t[before]) / gap : 0.0;
        size_t known = (size_t)newest + k;
        if (known > last) known = last;
        if (known < after) known = after;
        double value;
        if (part < whole)
            value = v[before];
        else if (part > 1.0 - whole)
            value = v[after];
        else
            value = at_part(t, v, before, known, part);
        ((double *)found.buf)[k] = value;
    }
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&times);
    PyBuffer_Release(&values);
    PyBuffer_Release(&wanted);
    PyBuffer_Release(&found);
    if (!ready) return NULL;
    return PyLong_FromSize_t(before);
}

PyObject *between_even(PyObject *module, PyObject *args) {
    static const double t[DBO_WINDOW] = {0.0, 1.0, 2.0, 3.0, 4.0, 5.0};
    Py_buffer values, found;
    double part;
    int k, ready = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*w*id", &values, &found, &k, &part)) return NULL;
    const size_t count = NUMBERS(found);
    if (NUMBERS(values) != count + DBO_WINDOW - 1 || k < 0 || k > DBO_WINDOW - 2) {
        PyErr_SetString(PyExc_ValueError, "arrays of unlike lengths, or no such place in the window");
        goto done;
    }
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    for (size_t j = 0; j < count; j++)
        ((double *)found.buf)[j] = dbo_between(t, (const double *)values.buf + j, k, part);
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&values);
    PyBuffer_Release(&found);
    if (!ready) return NULL;
    Py_RETURN_NONE;
}
