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

/* `grey` counts the levels of every step-th pixel of every step-th row; `difference` how much neighbours among those
 * differ, in every step-th of those rows; `steepest` holds for every 2·step-th row the greatest difference over two
 * pixels along the row, and across it. */
void slabcell_survey(const uint8_t *image, ptrdiff_t stride, int width, int height, int step, int64_t *grey,
                     int64_t *difference, uint8_t *steepest)
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
    for (int i = 0; i < 256; i++) {
        grey[i] = (int64_t)parts[0][i] + parts[1][i] + parts[2][i] + parts[3][i];
        difference[i] = differences[i];
    }
    for (int v = 0, at = 0; v < height; v += 2 * step, at += 2) {
        const uint8_t *row = image + v * stride, *above = row - stride, *below = row + stride;
        uint8_t most = 0;
        for (int u = 0; u + 2 < width; u++) {
            const uint8_t a = row[u], b = row[u + 2];
            const uint8_t d = a > b ? a - b : b - a;
            most = d > most ? d : most;
        }
        steepest[at] = most;
        most = 0;
        if (v > 0 && v + 1 < height)
            for (int u = 0; u < width; u++) {
                const uint8_t a = above[u], b = below[u];
                const uint8_t d = a > b ? a - b : b - a;
                most = d > most ? d : most;
            }
        steepest[at + 1] = most;
    }
}

/* The best split of a histogram in two populations, on a scale `values`; thresholds.py is the reference.  `found`:
 * level, means of both, and the share of the smaller one that lies half way between.  Returns 0 if there is none. */
int slabcell_split(const int64_t *histogram, const double *values, double *found)
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
