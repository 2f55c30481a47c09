/* dbo_kernel.c, dbo_dynamics.c and dbo_plays.c as a Python extension in the limited ABI. Arguments are checked by gears.py; here
 * only lengths are, so that no mistake there can read or write beyond a buffer. */
#include "_kernel.h"

#include <string.h>

#include "dbo_dynamics.h"
#include "dbo_kernel.h"
#include "dbo_plays.h"

/* One operator, its limits and its state, held from one live sample to the next. */
typedef struct {
    PyObject_HEAD
    Py_buffer gears;
    Py_buffer guide;
    dbo_backlash op;
    dbo_limits limits;
    double largest_change;
    int limited;
    double *decay;
    dbo_fixed_step fixed;
    void *table; /* of `fixed`; NULL where it gives nothing */
    dbo_backlash_state now;
    dbo_backlash_state next;
    int planned;
    size_t clipped;
    double *memory; /* of both, then gains and decay */
} stepper;

static int too_short(const char *what) {
    PyErr_Format(PyExc_ValueError, "kernel buffer of the wrong length: %s", what);
    return 1;
}

/* The operator's table and guide out of buffers; 0 with an error set where lengths do not match. */
static int assemble(dbo_backlash *op, const Py_buffer *gears, const Py_buffer *guide, Py_ssize_t n) {
    const Py_ssize_t rows = gears->len / (Py_ssize_t)sizeof(dbo_gear) - 1;
    if (n < 1 || rows != n || (uint64_t)n >> 32) return !too_short("gears");
    op->gears = gears->buf;
    op->n = (size_t)n;
    op->run = 1;
    op->row_factor = DBO_ROW_FACTOR(1);
    op->parts = (size_t)guide->len / sizeof(dbo_place);
    op->guide = op->parts > 1 ? guide->buf : NULL;
    if (op->guide) op->parts--;
    op->parts_per_x = (double)op->parts / op->gears[rows].x;
    return 1;
}

#define STATE_WORDS(n) (((size_t)(n) + 63) / 64)

/* Room for the checkpoints of a state, which the caller frees, and behind them its turns; 0 with an error set. */
static int take_turns(const dbo_backlash *op, dbo_backlash_state *state) {
    const size_t checkpoints = op->n / DBO_SPACING;
    state->checkpoints = PyMem_Malloc(checkpoints * sizeof(dbo_checkpoint) + op->n * sizeof(dbo_place));
    if (!state->checkpoints) {
        PyErr_NoMemory();
        return 0;
    }
    state->turns = (dbo_place *)(void *)(state->checkpoints + checkpoints);
    return 1;
}

/* Room for a state, as above, and its bits in it; 0 with an error set. */
static int take_state(const dbo_backlash *op, dbo_backlash_state *state, const Py_buffer *words) {
    if ((size_t)words->len < STATE_WORDS(op->n) * sizeof(uint64_t)) return !too_short("words");
    if (!take_turns(op, state)) return 0;
    dbo_backlash_load(op, state, words->buf);
    return 1;
}

/* What a fixed time step makes constant, in one piece of memory that the caller frees; NULL where there is none. */
static void *fixed_step(const dbo_backlash *op, const double *decay, dbo_fixed_step *fixed) {
    const size_t tables = op->n * sizeof(dbo_fixed_gear) + op->terms * sizeof(double);
    char *memory = PyMem_Malloc(tables + (op->parts + 1) * sizeof(dbo_place));
    dbo_fixed_gear *gears = (dbo_fixed_gear *)(void *)memory;
    if (memory)
        *fixed = dbo_prepare_fixed_step(op, decay, (double *)(gears + op->n), gears,
                                        op->guide ? (dbo_place *)(void *)(memory + tables) : NULL);
    return memory;
}

/* Without a memory the actuator rests at the first sample: with factors of 0 nothing of the past is left. */
static PyObject *backlash_run(PyObject *module, PyObject *args) {
    Py_buffer gears, guide, words, gain, memory, x, y, decay, step;
    dbo_backlash op;
    dbo_backlash_state state;
    dbo_limits limits;
    dbo_counts counts = {0, 0};
    dbo_fixed_step fixed;
    void *table = NULL;
    double *none = NULL;
    Py_ssize_t n;
    int limited, rests, ready = 0;
    size_t count, rows, first = 0;
    (void)module;
    state.checkpoints = NULL;
    if (!PyArg_ParseTuple(args, "y*y*nddpy*dpw*w*pdy*w*y*pdddy*", &gears, &guide, &n, &op.x0, &op.y0, &op.extend,
                          &gain, &op.reference, &op.memory_on_output, &words, &memory, &rests, &state.last, &x, &y,
                          &decay, &limited, &limits.low, &limits.high, &limits.slack, &step))
        return NULL;
    count = NUMBERS(x);
    op.terms = NUMBERS(gain);
    op.gain = gain.buf;
    state.memory = memory.buf;
    rows = op.terms ? NUMBERS(decay) / op.terms : 1;
    limits.step = NUMBERS(step) ? step.buf : NULL;
    limits.step_stride = NUMBERS(step) > 1;
    if (!assemble(&op, &gears, &guide, n)) goto done;
    if (NUMBERS(y) != count && too_short("y")) goto done;
    if (NUMBERS(memory) != op.terms && too_short("memory")) goto done;
    if (rows != 1 && rows != count && too_short("decay")) goto done;
    if (NUMBERS(step) > 1 && NUMBERS(step) != count && too_short("step")) goto done;
    if (!take_state(&op, &state, &words)) goto done;
    if (op.terms && rests && count) {
        none = PyMem_Calloc(op.terms, sizeof(double));
        if (!none) {
            PyErr_NoMemory();
            goto done;
        }
        *(double *)y.buf = dbo_backlash_step(&op, &state, *(double *)x.buf, none, limited ? &limits : NULL, &counts);
        first = 1;
        if (limits.step) limits.step += limits.step_stride;
    }
    ready = 1;
    if (rows == 1 && count - first > op.n && (limited || (op.terms && op.memory_on_output)))
        /* An even clock: divide once a gear instead of once a sample, where that is less work. */
        table = fixed_step(&op, decay.buf, &fixed);
    Py_BEGIN_ALLOW_THREADS
    {
        const double *in = (double *)x.buf + first;
        const double *factors = (double *)decay.buf + (rows == 1 ? 0 : first * op.terms);
        double *out = (double *)y.buf + first;
        const size_t clipped = counts.clipped;
        if (table)
            dbo_backlash_run_fixed(&op, &fixed, &state, in, out, count - first, limited ? &limits : NULL, &counts);
        else
            dbo_backlash_run(&op, &state, in, out, count - first, factors, rows == 1 ? 0 : op.terms,
                             limited ? &limits : NULL, &counts);
        if (!clipped && counts.clipped) counts.first_clipped += first;
    }
    dbo_backlash_bits(&op, &state, words.buf);
    Py_END_ALLOW_THREADS
    PyMem_Free(table);
done:
    PyMem_Free(none);
    PyMem_Free(state.checkpoints);
    PyBuffer_Release(&gears);
    PyBuffer_Release(&guide);
    PyBuffer_Release(&words);
    PyBuffer_Release(&gain);
    PyBuffer_Release(&memory);
    PyBuffer_Release(&x);
    PyBuffer_Release(&y);
    PyBuffer_Release(&decay);
    PyBuffer_Release(&step);
    if (!ready) return NULL;
    return Py_BuildValue("(nn)", (Py_ssize_t)counts.clipped, (Py_ssize_t)counts.first_clipped);
}

static PyObject *backlash_decay(PyObject *module, PyObject *args) {
    Py_buffer gears, guide, words, gain;
    dbo_backlash op;
    dbo_backlash_state state;
    double drive;
    Py_ssize_t n;
    int ready = 0;
    (void)module;
    state.checkpoints = NULL;
    state.memory = NULL;
    if (!PyArg_ParseTuple(args, "y*y*nddpy*dpw*d", &gears, &guide, &n, &op.x0, &op.y0, &op.extend, &gain,
                          &op.reference, &op.memory_on_output, &words, &drive))
        return NULL;
    op.terms = 0;
    op.gain = NULL;
    if (!assemble(&op, &gears, &guide, n)) goto done;
    if (!take_state(&op, &state, &words)) goto done;
    dbo_backlash_decay(&op, &state, op.n, NULL, drive);
    dbo_backlash_bits(&op, &state, words.buf);
    ready = 1;
done:
    PyMem_Free(state.checkpoints);
    PyBuffer_Release(&gears);
    PyBuffer_Release(&guide);
    PyBuffer_Release(&gain);
    PyBuffer_Release(&words);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

/* The words of the settled state at a drive: of the gears inside the range, beside what others have in `spare`. */
static void settled_words(const dbo_backlash *inside, dbo_backlash_state *state, const Py_buffer *spare, double drive,
                          uint64_t *words) {
    const double width = inside->gears[inside->n].x;
    const uint64_t *others = spare->buf;
    memset(words, 0, (size_t)spare->len);
    if (drive >= inside->x0 + width)
        for (size_t i = 0; i < inside->n; i++) words[i / 64] |= UINT64_C(1) << (i & 63);
    else if (drive > inside->x0) {
        dbo_backlash_decay(inside, state, inside->n, NULL, drive);
        dbo_backlash_bits(inside, state, words);
    }
    for (size_t k = 0; k < (size_t)spare->len / sizeof(uint64_t); k++) words[k] |= others[k];
}

/* The drive that an inverse operator makes of an output at rest in a state; `none` are factors of 0. */
static double rested(const dbo_backlash *op, dbo_backlash_state *state, const uint64_t *words, double output,
                     const double *none) {
    memset(state->memory, 0, op->terms * sizeof(double));
    dbo_backlash_load(op, state, words);
    return dbo_backlash_step(op, state, output, none, NULL, NULL);
}

/* The drive whose settled state leads to an output, from `below` to `above` or beyond them: halve the range until the
 * state of its middle does, or what is left is narrow: the output then steps over what is wanted, and the drive is
 * NaN. */
static PyObject *backlash_settled_at(PyObject *module, PyObject *args) {
    Py_buffer gears, guide, gain, inside_gears, inside_guide, inside_gain, spare;
    dbo_backlash op, inside;
    dbo_backlash_state state, settled;
    double output, below, above, narrow, reached, drive = NAN;
    double *numbers = NULL;
    uint64_t *words = NULL, *again;
    Py_ssize_t n, inside_n;
    int ready = 0;
    (void)module;
    state.checkpoints = settled.checkpoints = NULL;
    if (!PyArg_ParseTuple(args, "(y*y*nddpy*dp)(y*y*nddpy*dp)y*dddd", &gears, &guide, &n, &op.x0, &op.y0,
                          &op.extend, &gain, &op.reference, &op.memory_on_output, &inside_gears, &inside_guide,
                          &inside_n, &inside.x0, &inside.y0, &inside.extend, &inside_gain,
                          &inside.reference, &inside.memory_on_output, &spare, &output, &below, &above, &narrow))
        return NULL;
    op.terms = NUMBERS(gain);
    op.gain = gain.buf;
    inside.terms = 0;
    inside.gain = NULL;
    settled.memory = NULL;
    if (!assemble(&op, &gears, &guide, n)) goto done;
    if (!assemble(&inside, &inside_gears, &inside_guide, inside_n)) goto done;
    if ((size_t)spare.len < STATE_WORDS(op.n) * sizeof(uint64_t) && too_short("spare")) goto done;
    if (inside.n > op.n && too_short("gears")) goto done;
    numbers = PyMem_Calloc(2 * op.terms + 1, sizeof(double)); /* memory, and factors for a rest */
    words = PyMem_Malloc(2 * (size_t)spare.len);
    if (!numbers || !words) {
        PyErr_NoMemory();
        goto done;
    }
    again = words + (size_t)spare.len / sizeof(uint64_t);
    state.memory = numbers;
    if (!take_turns(&op, &state) || !take_turns(&inside, &settled)) goto done;
    ready = 1;
    settled_words(&inside, &settled, &spare, below, words);
    reached = rested(&op, &state, words, output, numbers + op.terms);
    if (reached <= below) drive = reached;
    settled_words(&inside, &settled, &spare, above, words);
    reached = rested(&op, &state, words, output, numbers + op.terms);
    if (drive != drive && reached >= above) drive = reached;
    while (drive != drive && above - below > narrow) {
        const double middle = below + 0.5 * (above - below);
        if (!(below < middle && middle < above)) break; /* neighbours in float64 */
        settled_words(&inside, &settled, &spare, middle, words);
        reached = rested(&op, &state, words, output, numbers + op.terms);
        if (below <= reached && reached <= above) {
            settled_words(&inside, &settled, &spare, reached, again);
            if (memcmp(words, again, (size_t)spare.len) == 0) drive = reached;
        }
        if (reached > middle)
            below = middle;
        else
            above = middle;
    }
done:
    PyMem_Free(numbers);
    PyMem_Free(words);
    PyMem_Free(state.checkpoints);
    PyMem_Free(settled.checkpoints);
    PyBuffer_Release(&gears);
    PyBuffer_Release(&guide);
    PyBuffer_Release(&gain);
    PyBuffer_Release(&inside_gears);
    PyBuffer_Release(&inside_guide);
    PyBuffer_Release(&inside_gain);
    PyBuffer_Release(&spare);
    if (!ready) return NULL;
    return Py_BuildValue("(ddd)", below, above, drive);
}

static void stepper_dealloc(PyObject *object) {
    stepper *self = (stepper *)object;
    PyTypeObject *type = Py_TYPE(object);
    PyBuffer_Release(&self->gears);
    PyBuffer_Release(&self->guide);
    PyMem_Free(self->now.checkpoints);
    PyMem_Free(self->memory);
    PyMem_Free(self->table);
    PyObject_Free(object);
    Py_DECREF((PyObject *)type);
}

/* Room for the turns that two states share, their memories, the terms' gains and decay; 0 with an error set. */
static int stepper_room(stepper *self, const Py_buffer *gain, const Py_buffer *decay) {
    const size_t terms = NUMBERS(*gain);
    double *numbers = PyMem_Calloc(4 * terms + 1, sizeof(double));
    self->memory = numbers;
    if (!numbers) {
        PyErr_NoMemory();
        return 0;
    }
    if (!take_turns(&self->op, &self->now)) return 0;
    self->next.turns = self->now.turns;
    self->next.checkpoints = self->now.checkpoints;
    self->now.memory = numbers;
    self->next.memory = numbers + terms;
    memcpy(numbers + 2 * terms, gain->buf, terms * sizeof(double));
    memcpy(numbers + 3 * terms, decay->buf, terms * sizeof(double));
    self->op.terms = terms;
    self->op.gain = numbers + 2 * terms;
    self->decay = numbers + 3 * terms;
    if (self->limited || (terms && self->op.memory_on_output)) /* else, or without memory, a slower way */
        self->table = fixed_step(&self->op, self->decay, &self->fixed);
    return 1;
}

static PyObject *stepper_new(PyTypeObject *type, PyObject *args, PyObject *keywords) {
    Py_buffer gain, decay;
    Py_ssize_t n;
    int ready = 0;
    stepper *self;
    (void)keywords;
    self = (stepper *)PyType_GenericAlloc(type, 0);
    if (!self) return NULL;
    if (!PyArg_ParseTuple(args, "y*y*nddpy*dpy*pdddd", &self->gears, &self->guide, &n, &self->op.x0,
                          &self->op.y0, &self->op.extend, &gain, &self->op.reference, &self->op.memory_on_output, &decay,
                          &self->limited, &self->limits.low, &self->limits.high, &self->limits.slack,
                          &self->largest_change)) {
        Py_DECREF((PyObject *)self);
        return NULL;
    }
    self->limits.step = self->largest_change == self->largest_change ? &self->largest_change : NULL;
    if (!assemble(&self->op, &self->gears, &self->guide, n)) goto done;
    if (NUMBERS(decay) != NUMBERS(gain) && too_short("decay")) goto done;
    if (!stepper_room(self, &gain, &decay)) goto done;
    dbo_backlash_load(&self->op, &self->now, NULL);
    ready = 1;
done:
    PyBuffer_Release(&gain);
    PyBuffer_Release(&decay);
    if (ready) return (PyObject *)self;
    Py_DECREF((PyObject *)self);
    return NULL;
}

static PyObject *stepper_set(PyObject *object, PyObject *args) {
    stepper *self = (stepper *)object;
    Py_buffer words, memory;
    double last;
    int ready = 0;
    if (!PyArg_ParseTuple(args, "y*y*d", &words, &memory, &last)) return NULL;
    if ((size_t)words.len < STATE_WORDS(self->op.n) * sizeof(uint64_t) && too_short("words")) goto done;
    if (NUMBERS(memory) != self->op.terms && too_short("memory")) goto done;
    memcpy(self->now.memory, memory.buf, self->op.terms * sizeof(double));
    self->now.last = last;
    dbo_backlash_load(&self->op, &self->now, words.buf);
    self->planned = 0;
    ready = 1;
done:
    PyBuffer_Release(&words);
    PyBuffer_Release(&memory);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

static PyObject *stepper_get(PyObject *object, PyObject *args) {
    const stepper *self = (stepper *)object;
    Py_buffer words, memory;
    int ready = 0;
    if (!PyArg_ParseTuple(args, "w*w*", &words, &memory)) return NULL;
    if ((size_t)words.len < STATE_WORDS(self->op.n) * sizeof(uint64_t) && too_short("words")) goto done;
    if (NUMBERS(memory) != self->op.terms && too_short("memory")) goto done;
    dbo_backlash_bits(&self->op, &self->now, words.buf);
    memcpy(memory.buf, self->now.memory, self->op.terms * sizeof(double));
    ready = 1;
done:
    PyBuffer_Release(&words);
    PyBuffer_Release(&memory);
    if (!ready) return NULL;
    return PyFloat_FromDouble(self->now.last);
}

/* The state to go to, for now that of the present, with the same turns: a step writes to none that `now` has. */
static dbo_backlash_state *from_now(stepper *self) {
    double *memory = self->next.memory;
    for (size_t j = 0; j < self->op.terms; j++) memory[j] = self->now.memory[j];
    self->next = self->now;
    self->next.memory = memory;
    return &self->next;
}

static double stepper_step(stepper *self, double x) {
    const dbo_limits *limits = self->limited ? &self->limits : NULL;
    dbo_backlash_state *next = from_now(self);
    dbo_counts counts = {0, 0};
    double y;
    if (self->table)
        y = dbo_backlash_step_fixed(&self->op, &self->fixed, next, x, limits, &counts);
    else
        y = dbo_backlash_step(&self->op, next, x, self->decay, limits, &counts);
    self->clipped = counts.clipped;
    self->planned = 1;
    return y;
}

static void stepper_follow(stepper *self, double y) {
    dbo_backlash_apply(&self->op, from_now(self), y, self->decay);
    self->clipped = 0;
    self->planned = 1;
}

static PyObject *stepper_plan(PyObject *object, PyObject *value) {
    const double x = PyFloat_AsDouble(value);
    if (PyErr_Occurred()) return NULL;
    return PyFloat_FromDouble(stepper_step((stepper *)object, x));
}

static PyObject *stepper_commit(PyObject *object, PyObject *nothing) {
    stepper *self = (stepper *)object;
    const dbo_backlash_state before = self->now;
    (void)nothing;
    if (!self->planned) {
        PyErr_SetString(PyExc_ValueError, "nothing was planned to be committed");
        return NULL;
    }
    self->now = self->next;
    self->next = before;
    self->planned = 0;
    return Py_BuildValue("");
}

static PyObject *stepper_follow_output(PyObject *object, PyObject *value) {
    stepper *self = (stepper *)object;
    const double y = PyFloat_AsDouble(value);
    if (PyErr_Occurred()) return NULL;
    if (self->op.terms && !self->op.memory_on_output) {
        PyErr_SetString(PyExc_ValueError, "memory on the input: its output does not give the state");
        return NULL;
    }
    stepper_follow(self, y);
    return Py_BuildValue("");
}

static PyObject *stepper_limit(PyObject *object, PyObject *args) {
    dbo_limits *limits = &((stepper *)object)->limits;
    double low, high, slack;
    if (!PyArg_ParseTuple(args, "ddd", &low, &high, &slack)) return NULL;
    limits->low = low;
    limits->high = high;
    limits->slack = slack;
    limits->step = NULL;
    return Py_BuildValue("");
}

static PyObject *stepper_clipped(PyObject *object, void *nothing) {
    (void)nothing;
    return PyLong_FromSize_t(((const stepper *)object)->clipped);
}

static PyMethodDef stepper_methods[] = {
    {"plan", stepper_plan, METH_O, "The output for an input; nothing changes yet."},
    {"commit", stepper_commit, METH_NOARGS, "Go on to the state that was worked out last."},
    {"follow", stepper_follow_output, METH_O, "Work out the state that this output leads to; nothing changes yet."},
    {"limit", stepper_limit, METH_VARARGS, "Keep from now on to a range, and to no largest change."},
    {"set", stepper_set, METH_VARARGS, "Take over words, memory and the output before."},
    {"get", stepper_get, METH_VARARGS, "Fill words and memory; return the output before."},
    {NULL, NULL, 0, NULL}};

static PyGetSetDef stepper_attributes[] = {
    {"clipped", stepper_clipped, NULL, "Whether the last plan met the limits.", NULL},
    {NULL, NULL, NULL, NULL, NULL}};

static PyType_Slot stepper_slots[] = {
    {Py_tp_new, (void *)stepper_new},         {Py_tp_dealloc, (void *)stepper_dealloc},
    {Py_tp_methods, (void *)stepper_methods}, {Py_tp_getset, (void *)stepper_attributes},
    {0, NULL}};

static PyType_Spec stepper_spec = {"dbo_cli.model._kernel.Stepper", sizeof(stepper), 0, Py_TPFLAGS_DEFAULT,
                                   stepper_slots};

static PyObject *backlash_engagement(PyObject *module, PyObject *args) {
    Py_buffer gears, guide, words, x, rows, crossed;
    dbo_backlash op = {0};
    dbo_backlash_state state;
    Py_ssize_t n, group_size;
    size_t columns;
    int ready = 0;
    (void)module;
    state.checkpoints = NULL;
    if (!PyArg_ParseTuple(args, "y*y*ndpw*y*w*w*n", &gears, &guide, &n, &op.x0, &op.extend, &words, &x,
                          &rows, &crossed, &group_size))
        return NULL;
    if (!assemble(&op, &gears, &guide, n)) goto done;
    if (group_size < 1 && too_short("group_size")) goto done;
    columns = (op.n + (size_t)group_size - 1) / (size_t)group_size;
    if (NUMBERS(rows) != NUMBERS(x) * columns && too_short("rows")) goto done;
    if (NUMBERS(crossed) != columns && too_short("crossed")) goto done;
    if (!take_state(&op, &state, &words)) goto done;
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    dbo_backlash_engagement(&op, &state, x.buf, rows.buf, crossed.buf, NUMBERS(x),
                            (size_t)group_size);
    dbo_backlash_bits(&op, &state, words.buf);
    Py_END_ALLOW_THREADS
done:
    PyMem_Free(state.checkpoints);
    PyBuffer_Release(&gears);
    PyBuffer_Release(&guide);
    PyBuffer_Release(&words);
    PyBuffer_Release(&x);
    PyBuffer_Release(&rows);
    PyBuffer_Release(&crossed);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

static PyObject *memory_run(PyObject *module, PyObject *args) {
    Py_buffer memory, x, rows, decay;
    double reference;
    int rests, ready = 0;
    size_t terms, count, given, first = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "dw*py*w*y*", &reference, &memory, &rests, &x, &rows, &decay)) return NULL;
    terms = NUMBERS(memory);
    count = NUMBERS(x);
    given = terms ? NUMBERS(decay) / terms : 1;
    if (NUMBERS(rows) != count * terms && too_short("rows")) goto done;
    if (given != 1 && given != count && too_short("decay")) goto done;
    ready = 1;
    if (rests && count) { /* at the first sample */
        double *row = rows.buf, *rest = memory.buf;
        for (size_t j = 0; j < terms; j++) row[j] = rest[j] = *(double *)x.buf - reference;
        first = 1;
    }
    Py_BEGIN_ALLOW_THREADS
    dbo_memory_run(terms, reference, memory.buf, (double *)x.buf + first, (double *)rows.buf + first * terms,
                   count - first, (double *)decay.buf + (given == 1 ? 0 : first * terms), given == 1 ? 0 : terms);
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&memory);
    PyBuffer_Release(&x);
    PyBuffer_Release(&rows);
    PyBuffer_Release(&decay);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

static PyObject *point_run(PyObject *module, PyObject *args) {
    Py_buffer segments, x, y;
    double x0, y0;
    int ready = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*ddy*w*", &segments, &x0, &y0, &x, &y)) return NULL;
    if ((size_t)segments.len < sizeof(dbo_segment) && too_short("segments")) goto done;
    if (NUMBERS(y) != NUMBERS(x) && too_short("y")) goto done;
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    dbo_point_run(segments.buf, (size_t)segments.len / sizeof(dbo_segment), x0, y0, x.buf, y.buf,
                  NUMBERS(x));
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&segments);
    PyBuffer_Release(&x);
    PyBuffer_Release(&y);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

static PyObject *dynamics_run(PyObject *module, PyObject *args) {
    Py_buffer output, state, x, y, step;
    int ready = 0;
    size_t sections, count, rows;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*w*y*w*y*", &output, &state, &x, &y, &step)) return NULL;
    sections = (size_t)state.len / sizeof(dbo_section_state);
    count = NUMBERS(x);
    rows = sections ? (size_t)step.len / (sections * sizeof(dbo_section_step)) : 0;
    if (sections == 0 && too_short("state")) goto done;
    if ((size_t)output.len != sections * sizeof(dbo_section_output) && too_short("output")) goto done;
    if (NUMBERS(y) != count && too_short("y")) goto done;
    if (rows != 1 && rows != count && too_short("step")) goto done;
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    dbo_dynamics_run(sections, output.buf, state.buf, x.buf, y.buf, count, step.buf,
                     rows == 1 ? 0 : sections);
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&output);
    PyBuffer_Release(&state);
    PyBuffer_Release(&x);
    PyBuffer_Release(&y);
    PyBuffer_Release(&step);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

static PyObject *dynamics_undo(PyObject *module, PyObject *args) {
    Py_buffer numbers, weight, state, y, u;
    dbo_section_inverse section;
    const double *c;
    int ready = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*w*y*w*", &numbers, &weight, &state, &y, &u)) return NULL;
    if (NUMBERS(numbers) != 8 && too_short("numbers")) goto done;
    if (state.len != sizeof(dbo_inverse_state) && too_short("state")) goto done;
    if (NUMBERS(y) != NUMBERS(u) + NUMBERS(weight) && too_short("y")) goto done;
    c = numbers.buf;
    section.aa = c[0], section.ab = c[1], section.ba = c[2], section.bb = c[3];
    section.a_in = c[4], section.b_in = c[5], section.a_out = c[6], section.b_out = c[7];
    section.ahead = NUMBERS(weight);
    section.weight = weight.buf;
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    dbo_dynamics_undo(&section, state.buf, y.buf, u.buf, NUMBERS(u));
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&numbers);
    PyBuffer_Release(&weight);
    PyBuffer_Release(&state);
    PyBuffer_Release(&y);
    PyBuffer_Release(&u);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

/* The plays out of buffers; 0 with an error set where lengths do not match. The table has three or four rows. */
static int assemble_plays(dbo_plays *op, Py_ssize_t n, const Py_buffer *table, const Py_buffer *curve,
                          const Py_buffer *z) {
    const size_t padded = NUMBERS(*z), rows = padded ? NUMBERS(*table) / padded : 0;
    const double *numbers = table->buf;
    if (n < 1 || padded < (size_t)n || padded % DBO_PLAY_LANES) return !too_short("z");
    if (rows < 3 || rows > 4 || rows * padded != NUMBERS(*table)) return !too_short("table");
    if (curve && NUMBERS(*curve) != 0 && NUMBERS(*curve) != 2) return !too_short("curve");
    op->n = (size_t)n;
    op->padded = padded;
    op->up = numbers;
    op->down = numbers + padded;
    op->weight = numbers + 2 * padded;
    op->by_rate = rows == 4 ? numbers + 3 * padded : NULL;
    op->curved = curve && NUMBERS(*curve) == 2;
    op->cubic = op->curved ? ((const double *)curve->buf)[0] : 0.0;
    op->linear = op->curved ? ((const double *)curve->buf)[1] : 0.0;
    return 1;
}

static PyObject *plays_run(PyObject *module, PyObject *args) {
    Py_buffer table, curve, z, x, y, share;
    dbo_plays op;
    Py_ssize_t n;
    int ready = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "ny*y*w*y*w*y*", &n, &table, &curve, &z, &x, &y, &share)) return NULL;
    if (!assemble_plays(&op, n, &table, &curve, &z)) goto done;
    if (NUMBERS(y) != NUMBERS(x) && too_short("y")) goto done;
    if (NUMBERS(share) != (op.by_rate ? NUMBERS(x) : 0) && too_short("share")) goto done;
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    dbo_plays_run(&op, z.buf, x.buf, y.buf, NUMBERS(x), share.buf);
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&table);
    PyBuffer_Release(&curve);
    PyBuffer_Release(&z);
    PyBuffer_Release(&x);
    PyBuffer_Release(&y);
    PyBuffer_Release(&share);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

static PyObject *plays_rows(PyObject *module, PyObject *args) {
    Py_buffer table, z, x, rows;
    dbo_plays op;
    Py_ssize_t n;
    int ready = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "ny*w*y*w*", &n, &table, &z, &x, &rows)) return NULL;
    if (!assemble_plays(&op, n, &table, NULL, &z)) goto done;
    if (NUMBERS(rows) != NUMBERS(x) * op.n && too_short("rows")) goto done;
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    dbo_plays_rows(&op, z.buf, x.buf, rows.buf, NUMBERS(x));
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&table);
    PyBuffer_Release(&z);
    PyBuffer_Release(&x);
    PyBuffer_Release(&rows);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

static PyObject *plays_solve(PyObject *module, PyObject *args) {
    Py_buffer table, curve, z, y, x, share;
    dbo_plays op;
    Py_ssize_t n;
    int ready = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "ny*y*w*y*w*y*", &n, &table, &curve, &z, &y, &x, &share)) return NULL;
    if (!assemble_plays(&op, n, &table, &curve, &z)) goto done;
    if (NUMBERS(x) != NUMBERS(y) && too_short("x")) goto done;
    if (NUMBERS(share) != (op.by_rate ? NUMBERS(y) : 0) && too_short("share")) goto done;
    ready = 1;
    Py_BEGIN_ALLOW_THREADS
    dbo_plays_solve(&op, z.buf, y.buf, x.buf, NUMBERS(y), op.by_rate ? share.buf : NULL);
    Py_END_ALLOW_THREADS
done:
    PyBuffer_Release(&table);
    PyBuffer_Release(&curve);
    PyBuffer_Release(&z);
    PyBuffer_Release(&y);
    PyBuffer_Release(&x);
    PyBuffer_Release(&share);
    if (!ready) return NULL;
    return Py_BuildValue("");
}

static PyMethodDef methods[] = {
    {"backlash_run", backlash_run, METH_VARARGS, "Equations (1)-(12) over a block of samples."},
    {"backlash_decay", backlash_decay, METH_VARARGS, "The state after an oscillation that decays to a drive."},
    {"backlash_settled_at", backlash_settled_at, METH_VARARGS, "The drive whose settled state leads to an output."},
    {"backlash_engagement", backlash_engagement, METH_VARARGS, "Part of every gear in every sample."},
    {"memory_run", memory_run, METH_VARARGS, "Relaxation terms over a block of samples."},
    {"point_run", point_run, METH_VARARGS, "Equations (13)-(16) over a block of samples."},
    {"dynamics_run", dynamics_run, METH_VARARGS, "Linear sections over a block of samples."},
    {"dynamics_undo", dynamics_undo, METH_VARARGS, "The input of a linear section from its output."},
    {"plays_run", plays_run, METH_VARARGS, "A weighted sum of plays over a block of samples."},
    {"plays_rows", plays_rows, METH_VARARGS, "Every play in every sample."},
    {"plays_solve", plays_solve, METH_VARARGS, "The input of a weighted sum of plays from its output."},
    {"between", between, METH_VARARGS, "A signal at other times, smoothly between its samples."},
    {"between_even", between_even, METH_VARARGS, "Evenly spaced samples, shifted by a part of a step."},
    {NULL, NULL, 0, NULL}};

#define INTERFACE 6 /* of the functions' arguments; kernel.py has the same number and refuses another */

static int add_types(PyObject *module) {
    PyObject *type;
    if (PyModule_AddIntConstant(module, "INTERFACE", INTERFACE) < 0) return -1;
    type = PyType_FromModuleAndSpec(module, &stepper_spec, NULL);
    if (type == NULL || PyModule_AddType(module, (PyTypeObject *)type) < 0) {
        Py_XDECREF(type);
        return -1;
    }
    Py_DECREF(type);
    return 0;
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)add_types}, {0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernel", "The compiled recursions; see gears.py.", 0, methods, slots,
    NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModuleDef_Init(&definition); }
