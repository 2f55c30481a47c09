/* Many steppers in one call: the live drives of a mirror. See PythonBank in stepper.py; both give the same bits. */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include "_stepper.h"

#include <math.h>
#include <string.h>

#define NUMBERS(view) ((size_t)(view).len / sizeof(double))
#define LIMITS 8 /* rows of limits: low, high, most, last; the least and the greatest wanted, and played */
#define ROUNDING 1.7763568394002505e-15 /* as drives/gate.py has it */

/* What stands beside the gears of each channel, one after the other: 0, gain, offset for a scale; 1, m, x0, y0 and
 * three numbers a segment for points. Those of channel k begin at place[k]. */
typedef struct {
    double *numbers;
    size_t *place;
} curves;

typedef struct {
    PyObject_HEAD
    PyObject *steppers; /* a tuple, kept alive */
    stepper **channel;
    size_t count;
    curves before, after, back;
    double *low, *high, *most, *last; /* most and last: NaN where there is none */
    double *wanted_low, *wanted_high, *played_low, *played_high; /* what is further away is refused */
    double *volts;
    int planned;
    double *memory;
} bank;

static double through(const curves *all, size_t channel, double x) {
    const double *p = all->numbers + all->place[channel], *end = all->numbers + all->place[channel + 1];
    while (p < end) {
        if (p[0] == 0.0) {
            x = p[1] * x + p[2];
            p += 3;
        } else {
            const size_t m = (size_t)p[1];
            double y;
            dbo_point_run((const dbo_segment *)(const void *)(p + 4), m, p[2], p[3], &x, &y, 1);
            x = y;
            p += 4 + 3 * m;
        }
    }
    return x;
}

/* The states of a thousand channels are more than a fast cache holds: those of a channel some way ahead are asked
 * for while the present one is worked on. Nothing but time depends on it. */
#if defined(__GNUC__) || defined(__clang__)
#define FETCH(place) __builtin_prefetch((const void *)(place))
#else
#define FETCH(place) (void)(place)
#endif
#define AHEAD 4 /* channels; chosen: with 2 to 16 a frame of 1,000 takes the same time, to noise */

static void fetch_ahead(const bank *self, size_t k) {
    if (k + 2 * AHEAD < self->count) {
        const char *one = (const char *)self->channel[k + 2 * AHEAD];
        for (size_t at = 0; at < sizeof(stepper); at += 64) FETCH(one + at);
    }
    if (k + AHEAD < self->count) {
        const stepper *one = self->channel[k + AHEAD];
        const size_t up = (size_t)(one->now.zero * one->op.row_factor >> 32);
        const size_t down = (size_t)(one->now.set * one->op.row_factor >> 32);
        FETCH(one->now.turns + (one->now.depth > 0 ? one->now.depth - 1 : 0));
        FETCH(one->now.memory);
        FETCH(one->next.memory);
        FETCH(one->decay);
        FETCH(one->op.gears + up);
        FETCH(one->op.gears + down);
        if (one->table) FETCH(one->fixed.gears + up);
        if (one->table) FETCH(one->fixed.gears + down);
    }
}

/* Where the voltage goes that stands further outside the range than one step: inwards by that step.
 * NaN where it does not. */
static double inwards(const bank *self, size_t k) {
    const double last = self->last[k], most = self->most[k];
    if (last - self->high[k] > most) return last - most;
    if (self->low[k] - last > most) return last + most;
    return NAN;
}

/* Whether a voltage may follow the last one: DriveGate for one row. */
static int may_pass(const bank *self, size_t k, double volts) {
    const double low = self->low[k], high = self->high[k], last = self->last[k], most = self->most[k];
    int inside = low <= volts && volts <= high && volts - volts == 0.0; /* and finite */
    if (!isnan(last) && !inside && !(low <= last && last <= high))
        inside = last < low ? last <= volts && volts <= low : high <= volts && volts <= last;
    if (inside && !isnan(last) && !isnan(most)) {
        const double change = volts > last ? volts - last : last - volts;
        const double one = last < 0.0 ? -last : last, other = volts < 0.0 ? -volts : volts;
        inside = change <= most + ROUNDING * (one > other ? one : other);
    }
    return inside;
}

static void bank_dealloc(PyObject *object) {
    bank *self = (bank *)object;
    PyTypeObject *type = Py_TYPE(object);
    Py_XDECREF(self->steppers);
    PyMem_Free(self->channel);
    PyMem_Free(self->before.place);
    PyMem_Free(self->memory);
    PyObject_Free(object);
    Py_DECREF((PyObject *)type);
}

/* Whether one channel's numbers are whole curves. */
static int are_curves(const double *p, const double *end) {
    while (p < end) {
        double size = 3.0;
        if (p[0] != 0.0) {
            if (end - p < 7 || !(p[1] >= 1.0) || !(p[1] <= (double)(end - p))) return 0;
            size = 4.0 + 3.0 * p[1];
        }
        if (size > (double)(end - p)) return 0;
        p += (size_t)size;
    }
    return 1;
}

/* Copy numbers and places; 0 with an error set where they do not fit together. */
static int take_curves(curves *all, size_t count, const Py_buffer *numbers, const Py_buffer *places) {
    const uint64_t *given = places->buf;
    if ((size_t)places->len != (count + 1) * sizeof(uint64_t) || given[0] != 0 || given[count] != NUMBERS(*numbers)) {
        PyErr_SetString(PyExc_ValueError, "bank: places of curves");
        return 0;
    }
    memcpy(all->numbers, numbers->buf, (size_t)numbers->len);
    for (size_t k = 0; k <= count; k++) all->place[k] = (size_t)given[k];
    for (size_t k = 0; k < count; k++) {
        if (all->place[k] > all->place[k + 1] || all->place[k + 1] > NUMBERS(*numbers) ||
            !are_curves(all->numbers + all->place[k], all->numbers + all->place[k + 1])) {
            PyErr_SetString(PyExc_ValueError, "bank: curves");
            return 0;
        }
    }
    return 1;
}

/* Room for everything, and what was given in it; 0 with an error set. */
static int bank_fill(bank *self, Py_buffer *view) {
    const size_t n = self->count, sizes[3] = {NUMBERS(view[0]), NUMBERS(view[2]), NUMBERS(view[4])};
    curves *all[3] = {&self->before, &self->after, &self->back};
    double *free;
    size_t *place;
    if (NUMBERS(view[6]) != LIMITS * n) {
        PyErr_SetString(PyExc_ValueError, "bank: limits");
        return 0;
    }
    self->channel = PyMem_Calloc(n ? n : 1, sizeof(stepper *));
    place = PyMem_Calloc(3 * (n + 1), sizeof(size_t));
    self->before.place = place;
    self->memory = PyMem_Calloc(sizes[0] + sizes[1] + sizes[2] + (LIMITS + 1) * n + 1, sizeof(double));
    if (!self->channel || !place || !self->memory) {
        PyErr_NoMemory();
        return 0;
    }
    free = self->memory;
    for (int k = 0; k < 3; k++) {
        all[k]->place = place + (size_t)k * (n + 1);
        all[k]->numbers = free;
        free += sizes[k];
        if (!take_curves(all[k], n, &view[2 * k], &view[2 * k + 1])) return 0;
    }
    self->low = free, self->high = free + n, self->most = free + 2 * n, self->last = free + 3 * n;
    self->wanted_low = free + 4 * n, self->wanted_high = free + 5 * n;
    self->played_low = free + 6 * n, self->played_high = free + 7 * n;
    self->volts = free + LIMITS * n;
    memcpy(free, view[6].buf, LIMITS * n * sizeof(double));
    for (size_t k = 0; k < n; k++) {
        PyObject *one = PyTuple_GetItem(self->steppers, (Py_ssize_t)k);
        if (!one || !is_stepper(one)) {
            PyErr_SetString(PyExc_TypeError, "bank: a tuple of steppers is needed");
            return 0;
        }
        self->channel[k] = (stepper *)one;
    }
    return 1;
}

static PyObject *bank_new(PyTypeObject *type, PyObject *args, PyObject *keywords) {
    Py_buffer view[7];
    PyObject *steppers;
    int ready;
    bank *self;
    (void)keywords;
    if (!PyArg_ParseTuple(args, "Oy*y*y*y*y*y*y*", &steppers, &view[0], &view[1], &view[2], &view[3], &view[4],
                          &view[5], &view[6]))
        return NULL;
    self = (bank *)PyType_GenericAlloc(type, 0);
    ready = self != NULL && PyTuple_Check(steppers);
    if (ready) {
        Py_INCREF(steppers);
        self->steppers = steppers;
        self->count = (size_t)PyTuple_Size(steppers);
        ready = bank_fill(self, view);
    } else if (self) {
        PyErr_SetString(PyExc_TypeError, "bank: a tuple of steppers is needed");
    }
    for (int k = 0; k < 7; k++) PyBuffer_Release(&view[k]);
    if (ready) return (PyObject *)self;
    Py_XDECREF((PyObject *)self);
    return NULL;
}

/* One channel's voltage for an input; what stands far outside its range comes inwards instead. */
static double planned_volts(const bank *self, size_t k, double wanted, int gate) {
    stepper *one = self->channel[k];
    const double way = gate ? inwards(self, k) : NAN;
    double volts;
    if (way == way) {
        stepper_follow(one, through(&self->back, k, way));
        one->clipped = 1;
        return way;
    }
    volts = stepper_step(one, through(&self->before, k, wanted));
    if (self->after.place[k] < self->after.place[k + 1]) {
        volts = through(&self->after, k, volts);
        volts = volts < self->low[k] ? self->low[k] : volts;
        volts = volts > self->high[k] ? self->high[k] : volts;
    }
    return volts;
}

/* The voltages for an input each, the clipped ones marked. -1: done; k: input k is no number, or too far away;
 * -2 - k: the voltage of channel k breaks its limits. Nothing changes until commit. */
static PyObject *bank_plan(PyObject *object, PyObject *args) {
    bank *self = (bank *)object;
    Py_buffer x, y, clipped;
    Py_ssize_t bad = -1;
    int gate, ready;
    if (!PyArg_ParseTuple(args, "y*w*w*p", &x, &y, &clipped, &gate)) return NULL;
    ready = NUMBERS(x) == self->count && NUMBERS(y) == self->count && (size_t)clipped.len == self->count;
    self->planned = 0;
    for (size_t k = 0; ready && k < self->count && bad == -1; k++) {
        const double wanted = ((const double *)x.buf)[k];
        if (!(self->wanted_low[k] < wanted && wanted < self->wanted_high[k])) bad = (Py_ssize_t)k;
    }
    for (size_t k = 0; ready && k < self->count && bad == -1; k++) {
        double volts;
        fetch_ahead(self, k);
        volts = planned_volts(self, k, ((const double *)x.buf)[k], gate);
        ((unsigned char *)clipped.buf)[k] = self->channel[k]->clipped != 0;
        ((double *)y.buf)[k] = self->volts[k] = volts;
        if (gate && !may_pass(self, k, volts)) bad = -2 - (Py_ssize_t)k;
    }
    self->planned = ready && bad == -1;
    PyBuffer_Release(&x);
    PyBuffer_Release(&y);
    PyBuffer_Release(&clipped);
    if (ready) return PyLong_FromSsize_t(bad);
    PyErr_SetString(PyExc_ValueError, "bank: arrays of the wrong length");
    return NULL;
}

/* The first channel whose voltage may not follow the last one, or -1. */
static PyObject *bank_check(PyObject *object, PyObject *args) {
    const bank *self = (const bank *)object;
    Py_buffer volts;
    Py_ssize_t bad = -1;
    int ready;
    if (!PyArg_ParseTuple(args, "y*", &volts)) return NULL;
    ready = NUMBERS(volts) == self->count;
    for (size_t k = 0; ready && k < self->count && bad == -1; k++)
        if (!may_pass(self, k, ((const double *)volts.buf)[k])) bad = (Py_ssize_t)k;
    PyBuffer_Release(&volts);
    if (ready) return PyLong_FromSsize_t(bad);
    PyErr_SetString(PyExc_ValueError, "bank: arrays of the wrong length");
    return NULL;
}

static PyObject *bank_commit(PyObject *object, PyObject *nothing) {
    bank *self = (bank *)object;
    (void)nothing;
    if (!self->planned) {
        PyErr_SetString(PyExc_ValueError, "nothing was planned to be committed");
        return NULL;
    }
    for (size_t k = 0; k < self->count; k++) {
        stepper *one = self->channel[k];
        const dbo_backlash_state before = one->now;
        one->now = one->next;
        one->next = before;
        one->planned = 0;
        self->last[k] = self->volts[k];
    }
    self->planned = 0;
    return Py_BuildValue("");
}

/* The states that voltages lead to which were not planned here. -1: done; k: voltage k is no number, or too far
 * away. Nothing changes until commit. */
static PyObject *bank_follow(PyObject *object, PyObject *args) {
    bank *self = (bank *)object;
    Py_buffer volts;
    Py_ssize_t bad = -1;
    int ready;
    if (!PyArg_ParseTuple(args, "y*", &volts)) return NULL;
    ready = NUMBERS(volts) == self->count;
    for (size_t k = 0; ready && k < self->count && bad == -1; k++) {
        const double given = ((const double *)volts.buf)[k];
        const dbo_backlash *op = &self->channel[k]->op;
        if (!(self->played_low[k] < given && given < self->played_high[k])) bad = (Py_ssize_t)k;
        if (op->terms && !op->memory_on_output) ready = 0;
    }
    for (size_t k = 0; ready && k < self->count && bad == -1; k++) {
        const double given = ((const double *)volts.buf)[k];
        stepper_follow(self->channel[k], through(&self->back, k, given));
        self->volts[k] = given;
    }
    if (ready && bad == -1) self->planned = 1;
    PyBuffer_Release(&volts);
    if (ready) return PyLong_FromSsize_t(bad);
    PyErr_SetString(PyExc_ValueError, "bank: arrays of the wrong length, or memory on the input");
    return NULL;
}

static PyMethodDef bank_methods[] = {
    {"plan", bank_plan, METH_VARARGS, "The voltages for an input each; nothing changes yet."},
    {"check", bank_check, METH_VARARGS, "The first voltage that may not follow, or -1."},
    {"commit", bank_commit, METH_NOARGS, "Go on to the states that were worked out last."},
    {"follow", bank_follow, METH_VARARGS, "Work out the states that these voltages lead to; nothing changes yet."},
    {NULL, NULL, 0, NULL}};

static PyType_Slot bank_slots[] = {{Py_tp_new, (void *)bank_new},
                                   {Py_tp_dealloc, (void *)bank_dealloc},
                                   {Py_tp_methods, (void *)bank_methods},
                                   {0, NULL}};

PyType_Spec bank_spec = {"dbo_cli.hysteresis._kernel.Bank", sizeof(bank), 0, Py_TPFLAGS_DEFAULT, bank_slots};
