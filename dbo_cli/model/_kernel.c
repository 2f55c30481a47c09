/* The recursions of dbo_kernel.c, dbo_dynamics.c, dbo_plays.c and dbo_interpolation.h as a Python extension in the
 * limited ABI. Arguments are checked by gears.py and delay.py; here only lengths are, so that no mistake there can read
 * or write beyond a buffer. */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdarg.h>
#include <string.h>

#include "dbo_dynamics.h"
#include "dbo_interpolation.h"
#include "dbo_kernel.h"
#include "dbo_plays.h"

#define NUMBERS(view) ((size_t)(view).len / sizeof(double))
#define FUNCTION(name) static PyObject *name(PyObject *Py_UNUSED(module), PyObject *args)

static int too_short(const char *what) {
    PyErr_Format(PyExc_ValueError, "kernel buffer of the wrong length: %s", what);
    return 1;
}

/* Releases buffers; 0 where an error is set. */
static int release(Py_buffer *view, ...) {
    va_list more;
    va_start(more, view);
    for (; view; view = va_arg(more, Py_buffer *)) PyBuffer_Release(view);
    va_end(more);
    return PyErr_Occurred() == NULL;
}

#define RELEASE(...) release(__VA_ARGS__, (Py_buffer *)NULL)
#define RELEASED(...) (RELEASE(__VA_ARGS__) ? Py_BuildValue("") : NULL)

/* An operator, and the buffers that it points into. */
typedef struct {
    Py_buffer gears;
    Py_buffer guide;
    Py_buffer gain;
    dbo_backlash op;
} operator;

/* A converter of PyArg_ParseTuple: the operator out of a tuple of gears.py; of no tuple, its buffers are released. */
static int operator_of(PyObject *tuple, void *address) {
    operator *self = address;
    dbo_backlash *op = &self->op;
    Py_ssize_t rows;
    if (tuple) {
        if (!PyArg_ParseTuple(tuple, "y*y*ddpy*dp", &self->gears, &self->guide, &op->x0, &op->y0, &op->extend,
                              &self->gain, &op->reference, &op->memory_on_output))
            return 0;
        rows = self->gears.len / (Py_ssize_t)sizeof(dbo_gear) - 1;
        op->gears = self->gears.buf;
        op->n = (size_t)rows;
        op->run = 1;
        op->row_factor = DBO_ROW_FACTOR(1);
        op->parts = (size_t)self->guide.len / sizeof(dbo_place);
        op->guide = op->parts > 1 ? self->guide.buf : NULL;
        op->terms = NUMBERS(self->gain);
        op->gain = self->gain.buf;
        if (rows > 0 && !((uint64_t)rows >> 32)) {
            if (op->guide) op->parts--;
            op->parts_per_x = (double)op->parts / op->gears[rows].x;
            return Py_CLEANUP_SUPPORTED;
        }
        too_short("gears");
    }
    (void)RELEASE(&self->gears, &self->guide, &self->gain);
    return 0;
}

/* One operator, its limits and its state, held from one live sample to the next. */
typedef struct {
    PyObject_HEAD
    operator taken;
    Py_buffer decay;
    dbo_limits limits;
    double largest_change;
    dbo_fixed_step fixed;
    void *table; /* of `fixed` */
    dbo_backlash_state now;
    dbo_backlash_state next;
    int planned;
    size_t clipped;
    double *memory; /* of both states */
} stepper;

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
FUNCTION(backlash_run) {
    operator taken;
    Py_buffer words, memory, x, y, decay, step;
    const dbo_backlash *op = &taken.op;
    dbo_backlash_state state;
    dbo_limits limits;
    dbo_counts counts = {0, 0};
    dbo_fixed_step fixed;
    void *table = NULL;
    double *none = NULL;
    int limited, rests;
    size_t count, rows, first = 0;
    state.checkpoints = NULL;
    if (!PyArg_ParseTuple(args, "O&w*w*pdy*w*y*pdddy*", operator_of, &taken, &words, &memory, &rests, &state.last, &x,
                          &y, &decay, &limited, &limits.low, &limits.high, &limits.slack, &step))
        return NULL;
    count = NUMBERS(x);
    state.memory = memory.buf;
    rows = op->terms ? NUMBERS(decay) / op->terms : 1;
    limits.step = NUMBERS(step) ? step.buf : NULL;
    limits.step_stride = NUMBERS(step) > 1;
    if (NUMBERS(y) != count && too_short("y")) goto done;
    if (NUMBERS(memory) != op->terms && too_short("memory")) goto done;
    if (rows != 1 && rows != count && too_short("decay")) goto done;
    if (NUMBERS(step) > 1 && NUMBERS(step) != count && too_short("step")) goto done;
    if (!take_state(op, &state, &words)) goto done;
    if (op->terms && rests && count) {
        none = PyMem_Calloc(op->terms, sizeof(double));
        if (!none) {
            PyErr_NoMemory();
            goto done;
        }
        *(double *)y.buf = dbo_backlash_step(op, &state, *(double *)x.buf, none, limited ? &limits : NULL, &counts);
        first = 1;
        if (limits.step) limits.step += limits.step_stride;
    }
    if (rows == 1 && count - first > op->n && (limited || (op->terms && op->memory_on_output)))
        /* An even clock: divide once a gear instead of once a sample, where that is less work. */
        table = fixed_step(op, decay.buf, &fixed);
    Py_BEGIN_ALLOW_THREADS
    {
        const double *in = (double *)x.buf + first;
        const double *factors = (double *)decay.buf + (rows == 1 ? 0 : first * op->terms);
        double *out = (double *)y.buf + first;
        const size_t clipped = counts.clipped;
        if (table)
            dbo_backlash_run_fixed(op, &fixed, &state, in, out, count - first, limited ? &limits : NULL, &counts);
        else
            dbo_backlash_run(op, &state, in, out, count - first, factors, rows == 1 ? 0 : op->terms,
                             limited ? &limits : NULL, &counts);
        if (!clipped && counts.clipped) counts.first_clipped += first;
    }
    dbo_backlash_bits(op, &state, words.buf);
    Py_END_ALLOW_THREADS
done:
    PyMem_Free(table);
    PyMem_Free(none);
    PyMem_Free(state.checkpoints);
    operator_of(NULL, &taken);
    if (!RELEASE(&words, &memory, &x, &y, &decay, &step)) return NULL;
    return Py_BuildValue("(nn)", (Py_ssize_t)counts.clipped, (Py_ssize_t)counts.first_clipped);
}

/* The state after an oscillation that decays to a drive: of the first `covered` gears, others stay as they are. */
FUNCTION(backlash_settled) {
    operator taken;
    Py_buffer words;
    Py_ssize_t covered;
    dbo_backlash_state state;
    double drive;
    state.checkpoints = NULL;
    if (!PyArg_ParseTuple(args, "O&w*nd", operator_of, &taken, &words, &covered, &drive)) return NULL;
    taken.op.terms = 0;
    if ((covered < 0 || (size_t)covered > taken.op.n) && too_short("covered")) goto done;
    if (!take_state(&taken.op, &state, &words)) goto done;
    dbo_backlash_decay(&taken.op, &state, (size_t)covered, words.buf, drive);
    dbo_backlash_bits(&taken.op, &state, words.buf);
done:
    PyMem_Free(state.checkpoints);
    operator_of(NULL, &taken);
    return RELEASED(&words);
}

/* The drive whose settled state leads to an output, from `below` to `above` or beyond them: halve the range until the
 * state of its middle does, or what is left is narrow: the output then steps over what is wanted, and the drive is
 * NaN. Others than the first `covered` gears stay as they are in `spare`. */
FUNCTION(backlash_settled_at) {
    operator taken;
    Py_buffer spare;
    Py_ssize_t covered;
    const dbo_backlash *op = &taken.op;
    dbo_backlash_state state;
    double output, below, above, narrow, reached, drive = NAN;
    double *none = NULL; /* factors for a rest, and the memory */
    uint64_t *words = NULL, *again;
    size_t size;
    state.checkpoints = NULL;
    if (!PyArg_ParseTuple(args, "O&y*ndddd", operator_of, &taken, &spare, &covered, &output, &below, &above, &narrow))
        return NULL;
    size = STATE_WORDS(op->n) * sizeof(uint64_t);
    if ((size_t)spare.len < size && too_short("spare")) goto done;
    if ((covered < 0 || (size_t)covered > op->n) && too_short("covered")) goto done;
    none = PyMem_Calloc(2 * op->terms + 1, sizeof(double));
    words = PyMem_Malloc(2 * size);
    if (!none || !words) {
        PyErr_NoMemory();
        goto done;
    }
    again = words + STATE_WORDS(op->n);
    state.memory = none + op->terms;
    if (!take_turns(op, &state)) goto done;
    dbo_backlash_decay(op, &state, (size_t)covered, spare.buf, below);
    reached = dbo_backlash_step(op, &state, output, none, NULL, NULL);
    if (reached <= below) drive = reached;
    dbo_backlash_decay(op, &state, (size_t)covered, spare.buf, above);
    reached = dbo_backlash_step(op, &state, output, none, NULL, NULL);
    if (drive != drive && reached >= above) drive = reached;
    while (drive != drive && above - below > narrow) {
        const double middle = below + 0.5 * (above - below);
        if (!(below < middle && middle < above)) break; /* neighbours in float64 */
        dbo_backlash_decay(op, &state, (size_t)covered, spare.buf, middle);
        dbo_backlash_bits(op, &state, words);
        reached = dbo_backlash_step(op, &state, output, none, NULL, NULL);
        if (below <= reached && reached <= above) {
            dbo_backlash_decay(op, &state, (size_t)covered, spare.buf, reached);
            dbo_backlash_bits(op, &state, again);
            if (memcmp(words, again, size) == 0) drive = reached;
        }
        if (reached > middle)
            below = middle;
        else
            above = middle;
    }
done:
    PyMem_Free(none);
    PyMem_Free(words);
    PyMem_Free(state.checkpoints);
    operator_of(NULL, &taken);
    if (!RELEASE(&spare)) return NULL;
    return Py_BuildValue("(ddd)", below, above, drive);
}

static void stepper_dealloc(PyObject *object) {
    stepper *self = (stepper *)object;
    PyTypeObject *type = Py_TYPE(object);
    operator_of(NULL, &self->taken);
    PyBuffer_Release(&self->decay);
    PyMem_Free(self->now.checkpoints);
    PyMem_Free(self->memory);
    PyMem_Free(self->table);
    PyObject_Free(object);
    Py_DECREF((PyObject *)type);
}

static PyObject *stepper_new(PyTypeObject *type, PyObject *args, PyObject *Py_UNUSED(keywords)) {
    Py_buffer words, memory;
    stepper *self = (stepper *)PyType_GenericAlloc(type, 0);
    const dbo_backlash *op;
    if (!self) return NULL;
    op = &self->taken.op;
    if (!PyArg_ParseTuple(args, "O&y*ddddy*y*d", operator_of, &self->taken, &self->decay, &self->limits.low,
                          &self->limits.high, &self->limits.slack, &self->largest_change, &words, &memory,
                          &self->now.last)) {
        Py_DECREF((PyObject *)self);
        return NULL;
    }
    self->limits.step = self->largest_change == self->largest_change ? &self->largest_change : NULL;
    if (NUMBERS(self->decay) != op->terms && too_short("decay")) goto done;
    if (NUMBERS(memory) != op->terms && too_short("memory")) goto done;
    self->memory = PyMem_Calloc(2 * op->terms + 1, sizeof(double));
    self->table = fixed_step(op, self->decay.buf, &self->fixed);
    if (!self->memory || !self->table) {
        PyErr_NoMemory();
        goto done;
    }
    if (!take_state(op, &self->now, &words)) goto done;
    memcpy(self->memory, memory.buf, op->terms * sizeof(double));
    self->now.memory = self->memory;
    self->next = self->now;
    self->next.memory = self->memory + op->terms;
done:
    if (RELEASE(&words, &memory)) return (PyObject *)self;
    Py_DECREF((PyObject *)self);
    return NULL;
}

static PyObject *stepper_get(PyObject *object, PyObject *args) {
    const stepper *self = (stepper *)object;
    const dbo_backlash *op = &self->taken.op;
    Py_buffer words, memory;
    if (!PyArg_ParseTuple(args, "w*w*", &words, &memory)) return NULL;
    if ((size_t)words.len < STATE_WORDS(op->n) * sizeof(uint64_t) && too_short("words")) goto done;
    if (NUMBERS(memory) != op->terms && too_short("memory")) goto done;
    dbo_backlash_bits(op, &self->now, words.buf);
    memcpy(memory.buf, self->now.memory, op->terms * sizeof(double));
done:
    return RELEASED(&words, &memory);
}

/* The state to go to, for now that of the present, with the same turns: a step writes to none that `now` has. */
static dbo_backlash_state *from_now(stepper *self) {
    double *memory = self->next.memory;
    for (size_t j = 0; j < self->taken.op.terms; j++) memory[j] = self->now.memory[j];
    self->next = self->now;
    self->next.memory = memory;
    self->planned = 1;
    return &self->next;
}

static PyObject *stepper_plan(PyObject *object, PyObject *value) {
    stepper *self = (stepper *)object;
    const double x = PyFloat_AsDouble(value);
    dbo_counts counts = {0, 0};
    double y;
    if (PyErr_Occurred()) return NULL;
    y = dbo_backlash_step_fixed(&self->taken.op, &self->fixed, from_now(self), x, &self->limits, &counts);
    self->clipped = counts.clipped;
    return PyFloat_FromDouble(y);
}

static PyObject *stepper_follow(PyObject *object, PyObject *value) {
    stepper *self = (stepper *)object;
    const double y = PyFloat_AsDouble(value);
    if (PyErr_Occurred()) return NULL;
    dbo_backlash_apply(&self->taken.op, from_now(self), y, self->decay.buf);
    self->clipped = 0;
    return Py_BuildValue("");
}

static PyObject *stepper_commit(PyObject *object, PyObject *Py_UNUSED(nothing)) {
    stepper *self = (stepper *)object;
    const dbo_backlash_state before = self->now;
    if (!self->planned) {
        PyErr_SetString(PyExc_ValueError, "nothing was planned to be committed");
        return NULL;
    }
    self->now = self->next;
    self->next = before;
    self->planned = 0;
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

static PyObject *stepper_clipped(PyObject *object, void *Py_UNUSED(nothing)) {
    return PyLong_FromSize_t(((const stepper *)object)->clipped);
}

static PyMethodDef stepper_methods[] = {
    {"plan", stepper_plan, METH_O, "The output for an input; nothing changes yet."},
    {"commit", stepper_commit, METH_NOARGS, "Go on to the state that was worked out last."},
    {"follow", stepper_follow, METH_O, "Work out the state that this output leads to; nothing changes yet."},
    {"limit", stepper_limit, METH_VARARGS, "Keep from now on to a range, and to no largest change."},
    {"get", stepper_get, METH_VARARGS, "Fill words and memory."},
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

FUNCTION(backlash_engagement) {
    operator taken;
    Py_buffer x, rows, crossed;
    const dbo_backlash *op = &taken.op;
    dbo_backlash_state state;
    Py_ssize_t group_size;
    size_t columns;
    state.checkpoints = NULL;
    if (!PyArg_ParseTuple(args, "O&y*w*w*n", operator_of, &taken, &x, &rows, &crossed, &group_size)) return NULL;
    if (group_size < 1 && too_short("group_size")) goto done;
    columns = (op->n + (size_t)group_size - 1) / (size_t)group_size;
    if (NUMBERS(rows) != NUMBERS(x) * columns && too_short("rows")) goto done;
    if (NUMBERS(crossed) != columns && too_short("crossed")) goto done;
    if (!take_turns(op, &state)) goto done;
    Py_BEGIN_ALLOW_THREADS
    dbo_backlash_load(op, &state, NULL);
    dbo_backlash_engagement(op, &state, x.buf, rows.buf, crossed.buf, NUMBERS(x), (size_t)group_size);
    Py_END_ALLOW_THREADS
done:
    PyMem_Free(state.checkpoints);
    operator_of(NULL, &taken);
    return RELEASED(&x, &rows, &crossed);
}

FUNCTION(memory_run) {
    Py_buffer memory, x, rows, decay;
    double reference;
    int rests;
    size_t terms, count, given, first = 0;
    if (!PyArg_ParseTuple(args, "dw*py*w*y*", &reference, &memory, &rests, &x, &rows, &decay)) return NULL;
    terms = NUMBERS(memory);
    count = NUMBERS(x);
    given = terms ? NUMBERS(decay) / terms : 1;
    if (NUMBERS(rows) != count * terms && too_short("rows")) goto done;
    if (given != 1 && given != count && too_short("decay")) goto done;
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
    return RELEASED(&memory, &x, &rows, &decay);
}

FUNCTION(point_run) {
    Py_buffer segments, x, y;
    double x0, y0;
    if (!PyArg_ParseTuple(args, "y*ddy*w*", &segments, &x0, &y0, &x, &y)) return NULL;
    if ((size_t)segments.len < sizeof(dbo_segment) && too_short("segments")) goto done;
    if (NUMBERS(y) != NUMBERS(x) && too_short("y")) goto done;
    Py_BEGIN_ALLOW_THREADS
    dbo_point_run(segments.buf, (size_t)segments.len / sizeof(dbo_segment), x0, y0, x.buf, y.buf,
                  NUMBERS(x));
    Py_END_ALLOW_THREADS
done:
    return RELEASED(&segments, &x, &y);
}

FUNCTION(dynamics_run) {
    Py_buffer output, state, x, y, step;
    size_t sections, count, rows;
    if (!PyArg_ParseTuple(args, "y*w*y*w*y*", &output, &state, &x, &y, &step)) return NULL;
    sections = (size_t)state.len / sizeof(dbo_section_state);
    count = NUMBERS(x);
    rows = sections ? (size_t)step.len / (sections * sizeof(dbo_section_step)) : 0;
    if (sections == 0 && too_short("state")) goto done;
    if ((size_t)output.len != sections * sizeof(dbo_section_output) && too_short("output")) goto done;
    if (NUMBERS(y) != count && too_short("y")) goto done;
    if (rows != 1 && rows != count && too_short("step")) goto done;
    Py_BEGIN_ALLOW_THREADS
    dbo_dynamics_run(sections, output.buf, state.buf, x.buf, y.buf, count, step.buf,
                     rows == 1 ? 0 : sections);
    Py_END_ALLOW_THREADS
done:
    return RELEASED(&output, &state, &x, &y, &step);
}

FUNCTION(dynamics_undo) {
    Py_buffer numbers, weight, state, y, u;
    dbo_section_inverse section;
    if (!PyArg_ParseTuple(args, "y*y*w*y*w*", &numbers, &weight, &state, &y, &u)) return NULL;
    if (NUMBERS(numbers) != 8 && too_short("numbers")) goto done;
    if (state.len != sizeof(dbo_inverse_state) && too_short("state")) goto done;
    if (NUMBERS(y) != NUMBERS(u) + NUMBERS(weight) && too_short("y")) goto done;
    memcpy(&section, numbers.buf, 8 * sizeof(double)); /* aa to b_out */
    section.ahead = NUMBERS(weight);
    section.weight = weight.buf;
    Py_BEGIN_ALLOW_THREADS
    dbo_dynamics_undo(&section, state.buf, y.buf, u.buf, NUMBERS(u));
    Py_END_ALLOW_THREADS
done:
    return RELEASED(&numbers, &weight, &state, &y, &u);
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

/* The output of plays, or (`solves`) the input from it. */
static PyObject *plays_through(PyObject *args, int solves) {
    Py_buffer table, curve, z, x, y, share;
    dbo_plays op;
    Py_ssize_t n;
    if (!PyArg_ParseTuple(args, "ny*y*w*y*w*y*", &n, &table, &curve, &z, &x, &y, &share)) return NULL;
    if (!assemble_plays(&op, n, &table, &curve, &z)) goto done;
    if (NUMBERS(y) != NUMBERS(x) && too_short("y")) goto done;
    if (NUMBERS(share) != (op.by_rate ? NUMBERS(x) : 0) && too_short("share")) goto done;
    Py_BEGIN_ALLOW_THREADS
    if (solves)
        dbo_plays_solve(&op, z.buf, x.buf, y.buf, NUMBERS(x), op.by_rate ? share.buf : NULL);
    else
        dbo_plays_run(&op, z.buf, x.buf, y.buf, NUMBERS(x), share.buf);
    Py_END_ALLOW_THREADS
done:
    return RELEASED(&table, &curve, &z, &x, &y, &share);
}

FUNCTION(plays_run) { return plays_through(args, 0); }

FUNCTION(plays_solve) { return plays_through(args, 1); }

FUNCTION(plays_rows) {
    Py_buffer table, z, x, rows;
    dbo_plays op;
    Py_ssize_t n;
    if (!PyArg_ParseTuple(args, "ny*w*y*w*", &n, &table, &z, &x, &rows)) return NULL;
    if (!assemble_plays(&op, n, &table, NULL, &z)) goto done;
    if (NUMBERS(rows) != NUMBERS(x) * op.n && too_short("rows")) goto done;
    Py_BEGIN_ALLOW_THREADS
    dbo_plays_rows(&op, z.buf, x.buf, rows.buf, NUMBERS(x));
    Py_END_ALLOW_THREADS
done:
    return RELEASED(&table, &z, &x, &rows);
}

static double at_part(const double *t, const double *v, size_t before, size_t known, double part) {
    size_t begin = before > 2 ? before - 2 : 0;
    int rises = known >= DBO_WINDOW - 1;
    if (rises && begin > known - (DBO_WINDOW - 1)) begin = known - (DBO_WINDOW - 1);
    if (rises && begin + (DBO_WINDOW - 1) > known) rises = 0;
    for (size_t i = 0; rises && i + 1 < DBO_WINDOW; i++) rises = t[begin + i] < t[begin + i + 1];
    if (rises) return dbo_between(t + begin, v + begin, (int)(before - begin), part);
    return v[before] + part * (v[before + 1] - v[before]);
}

FUNCTION(between) {
    Py_buffer times, values, wanted, found;
    double whole;
    Py_ssize_t newest;
    size_t before = 0;
    if (!PyArg_ParseTuple(args, "y*y*y*w*nd", &times, &values, &wanted, &found, &newest, &whole)) return NULL;
    const size_t count = NUMBERS(wanted);
    if (NUMBERS(times) == 0 || NUMBERS(values) != NUMBERS(times) || NUMBERS(found) != count || newest < 0) {
        too_short("values");
        goto done;
    }
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
    if (!RELEASE(&times, &values, &wanted, &found)) return NULL;
    return PyLong_FromSize_t(before);
}

FUNCTION(between_even) {
    static const double t[DBO_WINDOW] = {0.0, 1.0, 2.0, 3.0, 4.0, 5.0};
    Py_buffer values, found;
    double part;
    int k;
    if (!PyArg_ParseTuple(args, "y*w*id", &values, &found, &k, &part)) return NULL;
    const size_t count = NUMBERS(found);
    if (NUMBERS(values) != count + DBO_WINDOW - 1 || k < 0 || k > DBO_WINDOW - 2) {
        too_short("values");
        goto done;
    }
    Py_BEGIN_ALLOW_THREADS
    for (size_t j = 0; j < count; j++)
        ((double *)found.buf)[j] = dbo_between(t, (const double *)values.buf + j, k, part);
    Py_END_ALLOW_THREADS
done:
    return RELEASED(&values, &found);
}

static PyMethodDef methods[] = {
    {"backlash_run", backlash_run, METH_VARARGS, "Equations (1)-(12) over a block of samples."},
    {"backlash_settled", backlash_settled, METH_VARARGS, "The state after an oscillation that decays to a drive."},
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

#define INTERFACE 8 /* of the functions' arguments; kernel.py has the same number and refuses another */

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
