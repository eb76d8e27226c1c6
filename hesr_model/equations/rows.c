/* Programs of `operations.py`: operations on registers with one number per row of a block that fits
 * the first-level cache. One binary serves all equations, so a search over forms compiles nothing.
 * The compiler's flags define the operations' numbers. */
#include "law_math.h"

enum { BLOCK = 128, LANES = 8, STOPS = 4 };

enum { DONE, UNSTABLE };

typedef struct {
    int32_t operation, result, a, b, c;
} operation;

typedef struct {
    const operation *operations;
    const double *const *inputs; /* (rows) each: the first registers, dt first */
    const int64_t *strides;      /* of each input, in doubles */
    const double *given;         /* values equal for all rows: the next registers */
    const int64_t *firsts;       /* (first_count) first rows of records, increasing */
    const double *start;         /* (states, first_count) initial states of records */
    double *carried;             /* current value of each state */
    double **places;             /* (registers) addresses */
    double *work;                /* BLOCK per register and result, and 10 BLOCK */
    const int32_t *results;
    double *const *out;     /* (rows) for each result, or NULL */
    const double *target;   /* (rows) last column of the normal equations */
    const double *weights;  /* (rows) weights of the normal equations, or NULL */
    double *gram;           /* (results + 1)^2, upper triangle, or NULL */
    double *lanes;          /* (lane_count) partial sums of the products */
    const double **columns; /* (results + 4) */
    int64_t uniform, count; /* number of operations equal for all rows, and of all */
    int64_t input_count, given_count, first_count, result_count, lane_count, registers;
    int64_t uniform_count; /* number of given values and results of uniform operations */
    int64_t coming;        /* first record not before the block */
    int64_t first, stop;   /* rows to run; earlier ones are done */
    int64_t block;
    int64_t out_stride; /* of each result, in doubles */
    double euler;
    double unstable; /* rate dt of the refused Euler step */
} program;

#define INLINE static inline __attribute__((always_inline))

/* True if `even_sin` reduces all angles exactly. */
INLINE bool small_angles(const double *restrict x, int64_t n) {
    double outside = 0.0;
    for (int64_t i = 0; i < n; i++) {
        outside += fabs(x[i]) <= LARGEST_ANGLE ? 0.0 : 1.0;
    }
    return outside == 0.0;
}

/* For each record that begins in a block: its number f and its row i in the block. */
#define EACH_FIRST(f, i)                                                                           \
    for (int64_t f = p->coming, i; f < p->first_count && (i = p->firsts[f] - at) < n; f++)

/* x+ = x + x expm1(-z) + drive dt share(z), z = rate dt. */
INLINE int relax(program *p, int64_t state, int64_t at, int64_t n, double *restrict x,
                 const double *restrict drive, const double *restrict rate,
                 const double *restrict dt) {
    double *restrict a = p->work + (p->registers + p->result_count + 1) * BLOCK;
    double *restrict c = a + BLOCK;
    const double euler = p->euler;
    for (int64_t i = 0; i < n; i++) {
        const double z = positive(rate[i]) * dt[i], e = decay(z, euler);
        a[i] = 1.0 + e;
        c[i] = drive[i] * dt[i] * share(z, e, euler);
    }
    for (int64_t i = 0; euler > 0.0 && i < n; i++) {
        if (a[i] <= 0.0) {
            p->unstable = positive(rate[i]) * dt[i];
            return UNSTABLE;
        }
    }
    EACH_FIRST(f, i) {
        a[i] = 0.0;
        c[i] = p->start[state * p->first_count + f];
    }
    /* Combining two steps to one halves the dependency chain. */
    double *restrict factor = c + BLOCK, *restrict increment = factor + BLOCK / 2;
    for (int64_t i = 0; i < n / 2; i++) {
        factor[i] = a[2 * i + 1] * a[2 * i];
        increment[i] = a[2 * i + 1] * c[2 * i] + c[2 * i + 1];
    }
    double now = p->carried[state];
    for (int64_t i = 0; i < n / 2; i++) {
        x[2 * i] = a[2 * i] * now + c[2 * i];
        now = factor[i] * now + increment[i];
        x[2 * i + 1] = now;
    }
    if (n % 2) {
        now = a[n - 1] * now + c[n - 1];
        x[n - 1] = now;
    }
    p->carried[state] = now;
    return DONE;
}

/* x+ = clip(x + rate dt, bound) for up to STOPS independent states. */
INLINE void stops(program *p, const operation *o, int64_t count, int64_t at, int64_t n) {
    double *scratch = p->work + (p->registers + p->result_count + 1) * BLOCK;
    double *unused = scratch + 2 * STOPS * BLOCK, *x[STOPS], now[STOPS];
    const double *restrict dt = p->places[0];
    for (int64_t k = 0; k < STOPS; k++) {
        const operation *own = o + (k < count ? k : 0);
        double *restrict way = scratch + 2 * k * BLOCK, *restrict most = way + BLOCK;
        const double *restrict rate = p->places[own->a], *restrict bound = p->places[own->b];
        for (int64_t i = 0; i < n; i++) {
            way[i] = rate[i] * dt[i];
            most[i] = positive(bound[i]);
        }
        x[k] = k < count ? p->places[own->result] : unused;
        now[k] = p->carried[own->c];
    }
    for (int64_t from = 0, f = p->coming; from < n; f++) {
        const int64_t first = f < p->first_count ? p->firsts[f] - at : n;
        const int64_t to = first < n ? first : n;
        double x0 = now[0], x1 = now[1], x2 = now[2], x3 = now[3];
        const double *w = scratch;
        for (int64_t i = from; i < to; i++) {
            x[0][i] = x0 = clip(x0 + w[i], w[BLOCK + i]);
            x[1][i] = x1 = clip(x1 + w[2 * BLOCK + i], w[3 * BLOCK + i]);
            x[2][i] = x2 = clip(x2 + w[4 * BLOCK + i], w[5 * BLOCK + i]);
            x[3][i] = x3 = clip(x3 + w[6 * BLOCK + i], w[7 * BLOCK + i]);
        }
        now[0] = x0, now[1] = x1, now[2] = x2, now[3] = x3;
        for (int64_t k = 0; first < n && k < STOPS; k++) {
            const int64_t state = o[k < count ? k : 0].c;
            x[k][first] = now[k] = p->start[state * p->first_count + f];
        }
        from = to + 1;
    }
    for (int64_t k = 0; k < count; k++) {
        p->carried[o[k].c] = now[k];
    }
}

#define EACH(expression)                                                                           \
    for (int64_t i = 0; i < n; i++) {                                                              \
        d[i] = (expression);                                                                       \
    }                                                                                              \
    break
#define CASE(name, expression)                                                                     \
    case name:                                                                                     \
        EACH(expression)
#define CASE_OF_ANGLES(name, small, large)                                                         \
    case name:                                                                                     \
        if (!small_angles(a, n)) {                                                                 \
            EACH(large(a[i]));                                                                     \
        }                                                                                          \
        EACH(small(a[i]))

INLINE int operate(program *p, const operation *o, int64_t at, int64_t n) {
    double *restrict d = p->places[o->result];
    const double *restrict a = p->places[o->a], *restrict b = p->places[o->b];
    const double *restrict c = p->places[o->c];
    switch (o->operation) {
        CASE(ADD, a[i] + b[i]);
        CASE(SUBTRACT, a[i] - b[i]);
        CASE(MULTIPLY, a[i] * b[i]);
        CASE(DIVIDE, a[i] / b[i]);
        CASE(NEGATE, -a[i]);
        CASE(ROOT, __builtin_sqrt(a[i]));
        CASE(EXP, even_exp(a[i]));
        CASE(TANH, even_tanh(a[i]));
        CASE(LOG, log(a[i]));
        CASE(SINH, sinh(a[i]));
        CASE(COSH, cosh(a[i]));
        CASE(ATAN, atan(a[i]));
        CASE(ATAN2, atan2(a[i], b[i]));
        CASE(TAN, tan(a[i]));
        CASE(POWER, pow(a[i], b[i]));
        CASE_OF_ANGLES(SIN, even_sin, sine);
        CASE_OF_ANGLES(COS, even_cos, cosine);
        CASE_OF_ANGLES(CARDINAL_SINE, even_cardinal_sine, cardinal_sine);
        CASE(SGN, sgn(a[i]));
        CASE(ABSOLUTE, fabs(a[i]));
        CASE(POSITIVE, positive(a[i]));
        CASE(LARGER, larger(a[i], b[i]));
        CASE(CLIP, clip(a[i], b[i]));
        CASE(EXCEEDS, a[i] > b[i] ? 1.0 : 0.0);
        CASE(OVER, b[i] > 0.0 ? a[i] / b[i] : c[i]);
        CASE(CARRIED, p->carried[o->c]);
    case ADD_SAME: {
        const double same = b[0];
        EACH(a[i] + same);
    }
    case MULTIPLY_SAME: {
        const double same = b[0];
        EACH(a[i] * same);
    }
    case RELAX:
        return relax(p, o->c, at, n, d, a, b, p->places[0]);
    case STOP: {
        int64_t count = 1;
        while (count < STOPS && o + count < p->operations + p->count &&
               o[count].operation == STOP_BESIDE) {
            count++;
        }
        stops(p, o, count, at, n);
        break;
    }
    case STOP_BESIDE: /* moved with the first stop of its group */
        break;
    }
    return DONE;
}

typedef double vector __attribute__((vector_size(LANES * sizeof(double))));

INLINE vector eight(const double *from) {
    vector found;
    __builtin_memcpy(&found, from, sizeof found);
    return found;
}

/* Add the products of a column with four others to the lanes of four sums. The number of lanes does
 * not depend on the machine's vectors, so sums are the same everywhere. */
INLINE void add_products(double *sums, const double *a, const double *const *b, int64_t n) {
    vector s0 = eight(sums), s1 = eight(sums + LANES);
    vector s2 = eight(sums + 2 * LANES), s3 = eight(sums + 3 * LANES);
    const double *b0 = b[0], *b1 = b[1], *b2 = b[2], *b3 = b[3];
    int64_t i = 0;
    for (; i + LANES <= n; i += LANES) {
        const vector x = eight(a + i);
        s0 += x * eight(b0 + i);
        s1 += x * eight(b1 + i);
        s2 += x * eight(b2 + i);
        s3 += x * eight(b3 + i);
    }
    __builtin_memcpy(sums, &s0, sizeof s0);
    __builtin_memcpy(sums + LANES, &s1, sizeof s1);
    __builtin_memcpy(sums + 2 * LANES, &s2, sizeof s2);
    __builtin_memcpy(sums + 3 * LANES, &s3, sizeof s3);
    for (int64_t k = 0; i < n; i++, k++) {
        for (int64_t j = 0; j < 4; j++) {
            sums[j * LANES + k] += a[i] * b[j][i];
        }
    }
}

INLINE double total(const double *lanes) {
    double found[LANES];
    __builtin_memcpy(found, lanes, sizeof found);
    for (int64_t width = LANES / 2; width; width /= 2) {
        for (int64_t k = 0; k < width; k++) {
            found[k] += found[k + width];
        }
    }
    return found[0];
}

/* Add a block to the lanes of the normal equations; the target is the last column. */
INLINE void add_normal(program *p, int64_t at, int64_t n) {
    const int64_t count = p->result_count + 1;
    for (int64_t i = 0; i < count; i++) {
        const double *column = i < count - 1 ? p->places[p->results[i]] : p->target + at;
        if (p->weights) {
            double *restrict weighted = p->work + (p->registers + i) * BLOCK;
            const double *restrict plain = column, *restrict w = p->weights + at;
            for (int64_t k = 0; k < n; k++) {
                weighted[k] = w[k] * plain[k];
            }
            column = weighted;
        }
        p->columns[i] = column;
    }
    for (int64_t i = 1; i < 4; i++) { /* pad to groups of four */
        p->columns[count - 1 + i] = p->columns[count - 1];
    }
    double *sums = p->lanes;
    for (int64_t i = 0; i < count; i++) {
        for (int64_t j = i; j < count; j += 4, sums += 4 * LANES) {
            add_products(sums, p->columns[i], p->columns + j, n);
        }
    }
}

INLINE void finish_normal(program *p) {
    const int64_t count = p->result_count + 1;
    const double *sums = p->lanes;
    for (int64_t i = 0; i < count; i++) {
        for (int64_t j = i; j < count; j += 4, sums += 4 * LANES) {
            for (int64_t k = 0; k < 4 && j + k < count; k++) {
                p->gram[i * count + j + k] = total(sums + k * LANES);
            }
        }
    }
}

/* Compute the values equal for all rows. */
INLINE void prepare(program *p) {
    p->coming = 0;
    for (int64_t i = 0; i < p->registers; i++) {
        p->places[i] = p->work + i * BLOCK;
    }
    for (int64_t i = 0; i < p->given_count; i++) {
        p->places[p->input_count + i][0] = p->given[i];
    }
    for (int64_t i = 0; i < p->uniform; i++) {
        operate(p, p->operations + i, 0, 1);
    }
    for (int64_t i = 0; i < p->uniform_count; i++) {
        double *restrict of_all = p->places[p->input_count + i];
        const double of_one = of_all[0];
        for (int64_t k = 0; k < BLOCK; k++) {
            of_all[k] = of_one;
        }
    }
    for (int64_t i = 0; p->gram && i < p->lane_count; i++) {
        p->lanes[i] = 0.0;
    }
}

INLINE int all_rows(program *p) {
    if (p->first == 0) {
        prepare(p);
    }
    for (int64_t at = p->first; at < p->stop; at += p->block) {
        const int64_t n = p->stop - at < p->block ? p->stop - at : p->block;
        for (int64_t i = 0; i < p->input_count; i++) {
            const int64_t stride = p->strides[i];
            const double *from = p->inputs[i] + at * stride;
            if (stride == 1) {
                p->places[i] = (double *)from;
                continue;
            }
            double *restrict own = p->work + i * BLOCK;
            for (int64_t k = 0; k < n; k++) {
                own[k] = from[k * stride];
            }
        }
        for (int64_t i = p->uniform; i < p->count; i++) {
            const int ended = operate(p, p->operations + i, at, n);
            if (ended) {
                return ended;
            }
        }
        for (int64_t i = 0; p->out && i < p->result_count; i++) {
            const double *restrict from = p->places[p->results[i]];
            double *restrict to = p->out[i] + at * p->out_stride;
            if (p->out_stride == 1) {
                __builtin_memcpy(to, from, (uint64_t)n * sizeof(double));
                continue;
            }
            for (int64_t k = 0; k < n; k++) {
                to[k * p->out_stride] = from[k];
            }
        }
        if (p->gram) {
            add_normal(p, at, n);
        }
        while (p->coming < p->first_count && p->firsts[p->coming] < at + n) {
            p->coming++;
        }
    }
    if (p->gram) {
        finish_normal(p);
    }
    return DONE;
}

#define SHOWN __attribute__((visibility("default")))

enum { PLAIN, WIDE, WIDEST };

#if defined(__x86_64__)
#include <cpuid.h>

__attribute__((target("avx2"))) static int in_wide_vectors(program *p) {
    return all_rows(p);
}

__attribute__((target("avx512f,avx512dq,avx512vl"))) static int in_widest_vectors(program *p) {
    return all_rows(p);
}

/* Return the widest vectors of this machine; slow on virtual machines. */
SHOWN int widest(void) {
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & (1u << 27))) {
        return PLAIN;
    }
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0)); /* registers saved by the system */
    if ((low & 0x06) != 0x06 || !__get_cpuid_count(7, 0, &a, &b, &c, &d)) {
        return PLAIN;
    }
    if ((low & 0xe0) == 0xe0 && (b >> 16 & 1) && (b >> 17 & 1) && (b >> 31 & 1)) {
        return WIDEST;
    }
    return b >> 5 & 1 ? WIDE : PLAIN;
}

/* Run a program over rows and return its outcome; numbers do not depend on `vectors`. */
SHOWN int run(program *p, int vectors) {
    return vectors == WIDEST ? in_widest_vectors(p)
           : vectors == WIDE ? in_wide_vectors(p)
                             : all_rows(p);
}
#else
SHOWN int widest(void) {
    return PLAIN;
}

SHOWN int run(program *p, int vectors) {
    (void)vectors;
    return all_rows(p);
}
#endif

/* Solve the normal equations of (n + 1, n + 1) products with the target in the last column. The
 * first unknowns must not be negative: negative ones become zero one by one, the worst first.
 * `work` holds n^2 + 3 n numbers. Return false if the unknowns are ill-conditioned. */
SHOWN bool solve(const double *gram, int64_t n, int64_t non_negative, double *work, double *x,
                 double *cost) {
    double *factor = work, *scale = factor + n * n, *y = scale + n, *of = y + n;
    int64_t left = n;
    for (int64_t i = 0; i < n; i++) {
        const double square = gram[i * (n + 1) + i];
        if (!(square > 0.0 && square < 1e300)) {
            return false;
        }
        scale[i] = __builtin_sqrt(square);
        of[i] = (double)i;
    }
    for (;;) {
        for (int64_t i = 0; i < left; i++) {
            const int64_t row = (int64_t)of[i];
            double sum = gram[row * (n + 1) + n] / scale[row];
            for (int64_t j = 0; j <= i; j++) {
                const int64_t column = (int64_t)of[j]; /* increasing: the upper triangle */
                double entry = gram[column * (n + 1) + row] / (scale[row] * scale[column]);
                for (int64_t k = 0; k < j; k++) {
                    entry -= factor[i * n + k] * factor[j * n + k];
                }
                if (j < i) {
                    factor[i * n + j] = entry / factor[j * n + j];
                } else if (entry > 1e-11) {
                    factor[i * n + i] = __builtin_sqrt(entry);
                } else {
                    return false;
                }
            }
            for (int64_t k = 0; k < i; k++) {
                sum -= factor[i * n + k] * y[k];
            }
            y[i] = sum / factor[i * n + i];
        }
        for (int64_t i = left - 1; i >= 0; i--) {
            for (int64_t k = i + 1; k < left; k++) {
                y[i] -= factor[k * n + i] * y[k];
            }
            y[i] /= factor[i * n + i];
        }
        int64_t worst = -1;
        for (int64_t i = 0; i < left && of[i] < (double)non_negative; i++) {
            if (y[i] < (worst < 0 ? 0.0 : y[worst])) {
                worst = i;
            }
        }
        if (worst < 0) {
            break;
        }
        left--;
        for (int64_t i = worst; i < left; i++) {
            of[i] = of[i + 1];
        }
    }
    *cost = gram[n * (n + 1) + n];
    for (int64_t i = 0; i < n; i++) {
        x[i] = 0.0;
    }
    for (int64_t i = 0; i < left; i++) {
        const int64_t row = (int64_t)of[i];
        x[row] = y[i] / scale[row];
        *cost -= gram[row * (n + 1) + n] * x[row];
    }
    return true;
}
