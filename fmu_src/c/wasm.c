/* Minimal C library for an FMU in a browser page; building the compiler's own takes 15 s. The
 * compiler provides the functions of math.h. */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* As in C. */
int strcmp(const char *a, const char *b) {
    while (*a && *a == *b) {
        a++;
        b++;
    }
    return (unsigned char)*a - (unsigned char)*b;
}

/* --- memory of the page's single instance, never freed -------------------------------------- */

void *calloc(size_t count, size_t size) {
    static double room[1 << 17]; /* zeros; 1 MiB */
    static size_t used;
    const size_t wanted = (count * size + sizeof *room - 1) / sizeof *room;
    if (wanted > sizeof room / sizeof *room - used) {
        return NULL;
    }
    used += wanted;
    return room + used - wanted;
}

void free(void *memory) {
    (void)memory;
}

/* --- text: %s, %d, %u, %lu and %g with precisions, as used by the messages ------------------ */

/* A text that is written; `length` counts what does not fit as well. */
typedef struct {
    char *to;
    size_t size;
    size_t length;
} text;

/* Add a character. */
static void put(text *t, char c) {
    if (t->length + 1 < t->size) {
        t->to[t->length] = c;
    }
    t->length++;
}

/* Add a whole number with at least so many digits. */
static void put_whole(text *t, unsigned long value, int least) {
    char digits[20];
    int n = 0;
    do {
        digits[n++] = (char)('0' + value % 10);
        value /= 10;
    } while (value || n < least);
    while (n) {
        put(t, digits[--n]);
    }
}

#define HIDDEN ((uint64_t)1 << 52) /* implicit leading bit */

enum { DIGITS = 800 }; /* the longest double has 767 */

/* All digits of a positive number, the last one first, with its decimal exponent. A double is an
 * integer times 2^e, or times 5^-e / 10^-e. */
static int decimal(double value, char digits[DIGITS], int *exponent) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    const int power = (int)(bits >> 52);
    const int e = power ? power - 1075 : -1074;
    int n = 0;
    for (uint64_t whole = bits % HIDDEN + (power ? HIDDEN : 0); whole; whole /= 10) {
        digits[n++] = (char)(whole % 10);
    }
    *exponent = e < 0 ? e : 0;
    const int factor = e < 0 ? 5 : 2;
    for (int k = e < 0 ? -e : e; k > 0; k--) {
        int carry = 0;
        for (int i = 0; i < n; i++) {
            carry += factor * digits[i];
            digits[i] = (char)(carry % 10);
            carry /= 10;
        }
        if (carry) {
            digits[n++] = (char)carry;
        }
    }
    return n;
}

/* Round to `precision` digits, half to even. Returns the number of digits. */
static int rounded(char digits[DIGITS], int n, int precision, int *exponent) {
    const int gone = n - precision;
    if (gone > 0) {
        bool rest = false;
        for (int i = 0; i < gone - 1; i++) {
            rest |= digits[i] != 0;
        }
        const bool up =
            digits[gone - 1] > 5 || (digits[gone - 1] == 5 && (rest || digits[gone] % 2));
        memmove(digits, digits + gone, (size_t)precision);
        *exponent += gone;
        n = precision;
        int i = 0;
        for (; up && i < n && ++digits[i] == 10; i++) {
            digits[i] = 0;
        }
        if (up && i == n) { /* 9.99 has become 10.0 */
            digits[n - 1] = 1;
            (*exponent)++;
        }
    }
    int zeros = 0;
    while (zeros < n - 1 && !digits[zeros]) {
        zeros++;
    }
    memmove(digits, digits + zeros, (size_t)(n - zeros));
    *exponent += zeros;
    return n - zeros;
}

/* Add a text. */
static void put_text(text *t, const char *part) {
    for (; *part; part++) {
        put(t, *part);
    }
}

/* Add a number as %g does. */
static void put_number(text *t, double value, int precision) {
    if (signbit(value)) {
        put(t, '-');
        value = -value;
    }
    if (isnan(value)) {
        put_text(t, "nan");
        return;
    }
    if (isinf(value)) {
        put_text(t, "inf");
        return;
    }
    if (value == 0.0) {
        put(t, '0');
        return;
    }
    char digits[DIGITS];
    int exponent;
    int n = decimal(value, digits, &exponent);
    n = rounded(digits, n, precision, &exponent);
    const int power = exponent + n - 1; /* of the first digit */
    const bool plain = power >= -4 && power < precision;
    const int point = plain ? power : 0; /* the place of the first digit, */
    const int last = point - n + 1 < 0 ? point - n + 1 : 0;
    for (int place = point > 0 ? point : 0; place >= last; place--) {
        const int i = n - 1 - (point - place);
        const bool has_digit = place <= point && i >= 0;
        put(t, (char)('0' + (has_digit ? digits[i] : 0)));
        if (place == 0 && last < 0) {
            put(t, '.');
        }
    }
    if (!plain) {
        put(t, 'e');
        put(t, power < 0 ? '-' : '+');
        put_whole(t, (unsigned long)(power < 0 ? -power : power), 2);
    }
}

int vsnprintf(char *to, size_t size, const char *format, va_list values) {
    text t = {.to = to, .size = size};
    for (const char *c = format; *c; c++) {
        if (*c != '%') {
            put(&t, *c);
            continue;
        }
        int precision = 6;
        if (*++c == '.') {
            precision = 0;
            for (c++; *c >= '0' && *c <= '9'; c++) {
                precision = 10 * precision + (*c - '0');
            }
        }
        if (*c == 'g') {
            put_number(&t, va_arg(values, double), precision);
        } else if (*c == 's') {
            put_text(&t, va_arg(values, const char *));
        } else if (*c == 'd') {
            const long value = va_arg(values, int);
            if (value < 0) {
                put(&t, '-');
            }
            put_whole(&t, (unsigned long)(value < 0 ? -value : value), 1);
        } else if (*c == 'u') {
            put_whole(&t, va_arg(values, unsigned), 1);
        } else { /* %lu */
            put_whole(&t, va_arg(values, unsigned long), 1);
            c++;
        }
    }
    if (size) {
        to[t.length < size ? t.length : size - 1] = '\0';
    }
    return (int)t.length;
}

int snprintf(char *to, size_t size, const char *format, ...) {
    va_list values;
    va_start(values, format);
    const int length = vsnprintf(to, size, format, values);
    va_end(values);
    return length;
}
