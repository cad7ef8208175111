/* What is a picture like?  survey.py is the reference. */
#include "kernel.h"

int slabcell_kernel_version(void) { return KERNEL_VERSION; }

/* 3 where the library for x86-64-v3 (AVX2, FMA) may be used, else 1. */
int slabcell_cpu_level(void)
{
#if defined(__x86_64__) && defined(__GNUC__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2"))
        return 3;
#endif
    return 1;
}

static inline int apart(int a, int b) { return a > b ? a - b : b - a; }

enum { NOISE, SHARPEST, LIGHTEST, SPLIT, SPLIT_LEVEL, SPLIT_DARK, SPLIT_LIGHT, SPLIT_VALLEY };
#define RIM_STEP 4
#define SEARCHED 2 /* of the rows looked at, one of so many is searched for steep edges */
#define STEEPEST 4

/* The best split of a histogram in two populations, on a scale `values`; thresholds.py is the reference.  `found`:
 * level, means of both, and the share of the smaller one that lies half way between.  Returns 0 if there is none. */
static int split_in_two(const int64_t *histogram, const double *values, double *found)
{
    double weight = 0.0, moment = 0.0, all = 0.0, whole = 0.0, between[255], most = 0.0;
    for (int i = 0; i < 256; i++) {
        all += (double)histogram[i];
        whole += (double)histogram[i] * values[i];
    }
    for (int i = 0; i < 255; i++) {
        weight += (double)histogram[i];
        moment += (double)histogram[i] * values[i];
        const double above = all - weight;
        between[i] = 0.0;
        if (weight > 0.0 && above > 0.0) {
            const double apart = (whole - moment) / above - moment / weight;
            between[i] = weight * above * apart * apart;
        }
        most = fmax(most, between[i]);
    }
    if (!(most > 0.0))
        return 0;
    /* Between two populations with a gap the criterion is flat: take the middle of the plateau. */
    int plateau = 0, cut = 0;
    for (int i = 0; i < 255; i++)
        plateau += between[i] >= most * (1.0 - 1e-9);
    for (int i = 0, at = 0; i < 255; i++)
        if (between[i] >= most * (1.0 - 1e-9) && at++ == plateau / 2)
            cut = i;
    weight = moment = 0.0;
    for (int i = 0; i <= cut; i++) {
        weight += (double)histogram[i];
        moment += (double)histogram[i] * values[i];
    }
    const double low = moment / weight, high = (whole - moment) / (all - weight);
    double valley = 0.0;
    for (int i = 0; i < 256; i++)
        if (values[i] > low + 0.35 * (high - low) && values[i] < low + 0.65 * (high - low))
            valley += (double)histogram[i];
    found[0] = cut + 0.5;
    found[1] = low;
    found[2] = high;
    found[3] = valley / fmin(weight, all - weight);
    return 1;
}

/* The noise, from how much neighbours differ: the median of |N(0, s*sqrt(2))| is 0.954 s, interpolated within its level. */
static double noise_of(const uint32_t *differences)
{
    int64_t total = 0, below = 0;
    for (int i = 0; i < 256; i++)
        total += differences[i];
    if (!total)
        return 0.0;
    const double half = 0.5 * (double)total;
    int middle = 0;
    while ((double)(below + differences[middle]) < half)
        below += differences[middle++];
    const double share = (half - (double)below) / fmax(differences[middle], 1.0);
    return fmax(0.0, middle - 0.5 + share) / 0.954;
}

/* Counts over the levels: `grey` of every step-th pixel of every step-th row, `rim` of every RIM_STEP-th of the outermost
 * pixels.  `found`: the noise, from how much neighbours differ; the greatest difference over two pixels along or across
 * those rows in which it is greatest; the level that 0.5 % of the pixels exceed; and the split of the histogram on the
 * scale `values`.  `steepest` has room for two bytes of every SEARCHED*step-th row. */
void slabcell_survey(const uint8_t *image, ptrdiff_t stride, int width, int height, int step, const double *values,
                     uint8_t *steepest, int64_t *grey, int64_t *rim, double *found)
{
    uint32_t parts[4][256] = {{0}}, differences[256] = {0};
    for (int v = 0; v < height; v += step) {
        const uint8_t *row = image + v * stride;
        int u = 0, turn = 0;
        for (; u < width; u += step, turn = (turn + 1) & 3)
            parts[turn][row[u]]++;
        if (v % (step * step) == 0)
            for (u = step; u < width; u += step)
                differences[apart(row[u], row[u - step])]++;
    }
    int64_t total = 0;
    for (int i = 0; i < 256; i++) {
        grey[i] = (int64_t)parts[0][i] + parts[1][i] + parts[2][i] + parts[3][i];
        rim[i] = 0;
        total += grey[i];
    }
    int rows = 0;
    for (int v = 0; v < height; v += SEARCHED * step) {
        const uint8_t *row = image + v * stride, *above = row - stride, *below = row + stride;
        uint8_t most = 0;
        for (int u = 0; u + 2 < width; u++) {
            const uint8_t a = row[u], b = row[u + 2];
            const uint8_t d = a > b ? a - b : b - a;
            most = d > most ? d : most;
        }
        steepest[rows++] = most;
        most = 0;
        if (v > 0 && v + 1 < height)
            for (int u = 0; u < width; u++) {
                const uint8_t a = above[u], b = below[u];
                const uint8_t d = a > b ? a - b : b - a;
                most = d > most ? d : most;
            }
        steepest[rows++] = most;
    }
    for (int u = 0; u < width; u += RIM_STEP) {
        rim[image[u]]++;
        rim[image[(height - 1) * stride + u]]++;
    }
    for (int v = 0; v < height; v += RIM_STEP) {
        rim[image[v * stride]]++;
        rim[image[v * stride + width - 1]]++;
    }
    found[NOISE] = noise_of(differences);
    /* The median of the steepest STEEPEST rows, the lower one of the middle two. */
    uint8_t top[STEEPEST / 2] = {0};
    for (int i = 0; i < rows; i++) {
        uint8_t value = steepest[i];
        for (int k = 0; k < STEEPEST / 2; k++)
            if (value > top[k]) {
                const uint8_t less = top[k];
                top[k] = value;
                value = less;
            }
    }
    found[SHARPEST] = rows < STEEPEST ? -1.0 : top[STEEPEST / 2 - 1];
    int lightest = 255;
    for (int64_t above = grey[255]; lightest > 0 && above <= total / 200; above += grey[--lightest])
        ;
    found[LIGHTEST] = lightest;
    found[SPLIT] = split_in_two(grey, values, found + SPLIT_LEVEL);
}
