/* Where does the edge run, beside where it was expected?  edge_profile.py is the reference, and explains the model.
 *
 * This file includes profile_pixels.h once for each type of pixel.
 */
#include "kernel.h"

#define BINS_PER_PX 4
#define MAX_BINS 256
#define LANES 8
#define COLUMNS 7
enum { IN, OUT, ON_WALL, STEP, SLOPE_IN, SLOPE_OUT, WIDTH };
#define ITERATIONS 5
#define WIDE_WALL_PX 14.0
/* A piece bends away from its chord by at most this. */
#define MAX_SAG_PX 3.0
#define CONVERGED_PX 0.08
#define CONVERGED_BLUR 0.02
/* Bins this many widths of the blur from the edge show its two sides alone. */
#define BESIDE 2.0

/* Places among the bins are fixed point numbers; a bin counts up to 2^COUNT_BITS pixels. */
#define FIXED_BITS 22
#define FIXED 4194304.0
#define COUNT_BITS 10
#define MAX_HALF_PX 250.0
#define MAX_LINES 640
#define FAR 1e9
#define TWO_52 4503599627370496.0
#define MANTISSA ((uint64_t)0x433 << 52)

/* Density and integral of the normal distribution at n places, n a multiple of LANES.  In loops of their own, each of
 * which the compiler turns into vector instructions where there are any. */
static void normal_distribution(int n, const double *restrict table, const double *restrict x, double *restrict density,
                                double *restrict integral)
{
    const double limit = TABLE_REACH - 1e-9;
    double h[MAX_BINS], node[MAX_BINS];
    int32_t index[MAX_BINS];
    for (int i = 0; i < n; i++) {
        double at = x[i] < -limit ? -limit : x[i];
        at = at > limit ? limit : at;
        index[i] = (int32_t)((at + TABLE_REACH) * TABLE_STEPS + 0.5);
        node[i] = index[i] * (1.0 / TABLE_STEPS) - TABLE_REACH;
        h[i] = at - node[i];
    }
    for (int i = 0; i < n; i++) {
        density[i] = table[2 * index[i]];
        integral[i] = table[2 * index[i] + 1];
    }
    /* Taylor about the nearest node; the remainder is below 1e-9. */
    for (int i = 0; i < n; i++) {
        const double f = density[i], bent = node[i] * node[i] - 1.0;
        density[i] = f * (1.0 - node[i] * h[i] + 0.5 * bent * h[i] * h[i]);
        integral[i] += f * h[i] * (1.0 - 0.5 * node[i] * h[i] + bent * h[i] * h[i] * (1.0 / 6.0));
    }
}

/* Factorises a symmetric positive definite matrix in place (Cholesky); `diagonal` gets one over that of the factor. */
static int factorise(int n, double a[COLUMNS][COLUMNS], double diagonal[COLUMNS])
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = a[i][j];
            for (int k = 0; k < j; k++)
                sum -= a[i][k] * a[j][k];
            if (i == j) {
                if (!(sum > 0.0))
                    return 0;
                diagonal[i] = 1.0 / sqrt(sum);
            } else {
                a[i][j] = sum * diagonal[j];
            }
        }
    }
    return 1;
}

/* Solves the system of the factorised matrix in place. */
static void solve(int n, double a[COLUMNS][COLUMNS], const double diagonal[COLUMNS], double b[COLUMNS])
{
    for (int i = 0; i < n; i++) {
        double sum = b[i];
        for (int k = 0; k < i; k++)
            sum -= a[i][k] * b[k];
        b[i] = sum * diagonal[i];
    }
    for (int i = n - 1; i >= 0; i--) {
        double sum = b[i];
        for (int k = i + 1; k < n; k++)
            sum -= a[k][i] * b[k];
        b[i] = sum * diagonal[i];
    }
}

/* One diagonal element of the inverse of the factorised matrix. */
static double inverse_at(int n, double a[COLUMNS][COLUMNS], const double diagonal[COLUMNS], int at)
{
    double column[COLUMNS] = {0}, norm = 0.0;
    for (int i = at; i < n; i++) {
        double sum = i == at ? 1.0 : 0.0;
        for (int k = at; k < i; k++)
            sum -= a[i][k] * column[k];
        column[i] = sum * diagonal[i];
        norm += column[i] * column[i];
    }
    return norm;
}

/* One row of the normal equations: what column `p` gives with itself and those before it, and with the levels.  Written
 * out for each `p`, so that all sums of a row run side by side. */
static inline __attribute__((always_inline)) void product_row(const int p, int n, const double *const *column,
                                                              const double *weight, const double *level,
                                                              double normal[COLUMNS][COLUMNS], double *right)
{
    double sums[COLUMNS] = {0}, with_level = 0.0;
    for (int i = 0; i < n; i++) {
        const double weighted = weight[i] * column[p][i];
        with_level += weighted * level[i];
        for (int q = 0; q <= p; q++)
            sums[q] += weighted * column[q][i];
    }
    for (int q = 0; q <= p; q++)
        normal[p][q] = sums[q];
    right[p] = with_level;
}

static void products(int n, int columns, const double *const *column, const double *weight, const double *level,
                     double normal[COLUMNS][COLUMNS], double *right)
{
    product_row(0, n, column, weight, level, normal, right);
    product_row(1, n, column, weight, level, normal, right);
    product_row(2, n, column, weight, level, normal, right);
    product_row(3, n, column, weight, level, normal, right);
    product_row(4, n, column, weight, level, normal, right);
    if (columns > 5)
        product_row(5, n, column, weight, level, normal, right);
    if (columns > 6)
        product_row(6, n, column, weight, level, normal, right);
}

/* The mean level at one end of the profile, whose bins are sorted by depth. */
static double mean_beyond(int n, const double *count, const double *depth, const double *level, double limit, int below)
{
    double weight = 0.0, sum = 0.0;
    for (int k = 0; k < n; k++) {
        const int i = below ? k : n - 1 - k;
        if (below ? !(depth[i] < limit) : !(depth[i] > limit))
            break;
        weight += count[i];
        sum += count[i] * level[i];
    }
    return sum / fmax(weight, 1.0);
}

/* Where a sharp step would enclose the same light. */
static double starting_shift(int n, const double *count, const double *depth, const double *level, double inside,
                             double outside, double wall_light, double reach)
{
    double contrast = inside - outside, pixels = 0.0, deepest = 0.0, share = 0.0;
    if (fabs(contrast) < 1.0)
        contrast = 1.0;
    for (int i = 0; i < n; i++) {
        pixels += count[i];
        share += count[i] * (level[i] - outside) / contrast;
        deepest = fmax(deepest, -depth[i]);
    }
    share /= fmax(pixels, 1.0);
    return fmin(fmax(share * (deepest + reach) - reach - wall_light, 3.0 - reach), reach - 3.0);
}

/* Fits the model to one profile of so many bins, `filled` of which hold pixels, the first and the last among them; the
 * arrays have room up to a multiple of LANES. */
static void fit(int bins, double filled, double *restrict count, double *restrict depth, double *restrict level, double wall,
                double wall_ratio, const Model *restrict model, const double *restrict table, double *restrict result)
{
    const double reach = model->reach;
    const int wide = wall > WIDE_WALL_PX, blurred = model->fit_blur > 0.5;
    const double strip = wide ? 0.0 : wall, outer = wide ? WIDE_WALL_PX - 2.0 : wall + reach;
    const int with_wall = strip > 0.0;
    double column[COLUMNS][MAX_BINS], weight[MAX_BINS], error[MAX_BINS], place[MAX_BINS], bell[MAX_BINS];
    double s = model->sigma, pixels = 0.0;

    double inside = mean_beyond(bins, count, depth, level, reach - 2.0, 0);
    double outside = mean_beyond(bins, count, depth, level, -(outer - 2.0), 1);
    double grey_of_wall = wall_ratio * inside;
    double step = 0.0;
    if (!(model->near > 0.5)) {
        double contrast = inside - outside;
        if (fabs(contrast) < 1.0)
            contrast = 1.0;
        const double lit = strip * fmin(fmax((grey_of_wall - outside) / contrast, 0.0), 1.0);
        step = starting_shift(bins, count, depth, level, inside, outside, lit, reach);
    }
    /* Empty bins fill up the last vector. */
    const int n = (bins + LANES - 1) / LANES * LANES;
    for (int i = bins; i < n; i++) {
        count[i] = level[i] = 0.0;
        depth[i] = depth[bins - 1];
    }
    for (int i = 0; i < n; i++)
        pixels += count[i];
    /* The columns in use, side by side. */
    int used[COLUMNS], columns = 0, at_step = 0;
    for (int p = 0; p < COLUMNS; p++) {
        if ((p == ON_WALL && !with_wall) || (p == WIDTH && !blurred))
            continue;
        if (p == STEP)
            at_step = columns;
        used[columns++] = p;
    }
    double scatter = 0.0, normal[COLUMNS][COLUMNS], diagonal[COLUMNS], right[COLUMNS];
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
        const double per_s = 1.0 / s, taper = 1.0 / model->grain_reach, contrast = inside - outside;
        const double noise = model->noise, grainy = model->grain_inside, grainy_outside = model->grain_outside;
        double *restrict upper = column[IN], *restrict lower = column[OUT];
        for (int i = 0; i < n; i++)
            place[i] = (depth[i] + step) * per_s;
        normal_distribution(n, table, place, bell, upper);
        for (int i = 0; i < n; i++) {
            const double away = depth[i] + step, up = upper[i], low = 1.0 - up, beyond = -away - strip;
            lower[i] = low;
            column[STEP][i] = contrast * bell[i] * per_s;
            column[SLOPE_IN][i] = depth[i] * up;
            column[SLOPE_OUT][i] = depth[i] * low;
            const double outwards = beyond > 0.0 ? beyond : 0.0;
            const double from = (away > 0.0 ? away : outwards) * taper, square = from * from;
            weight[i] = count[i] / (noise + (grainy * up * up + grainy_outside * low * low) * (1.0 + square * square));
        }
        if (blurred)
            for (int i = 0; i < n; i++)
                column[WIDTH][i] = -contrast * bell[i] * place[i] * per_s;
        if (with_wall) {
            double both[MAX_BINS], far[MAX_BINS], beyond[MAX_BINS];
            for (int i = 0; i < n; i++)
                beyond[i] = place[i] + strip * per_s;
            normal_distribution(n, table, beyond, far, both);
            for (int i = 0; i < n; i++) {
                const double first = (inside - grey_of_wall) * bell[i], second = (grey_of_wall - outside) * far[i];
                lower[i] = 1.0 - both[i];
                column[ON_WALL][i] = both[i] - upper[i];
                column[STEP][i] = (first + second) * per_s;
                column[SLOPE_OUT][i] = depth[i] * (1.0 - both[i]);
                column[WIDTH][i] = -(first * place[i] + second * beyond[i]) * per_s;
            }
        }
        const double *in_use[COLUMNS];
        for (int p = 0; p < columns; p++)
            in_use[p] = column[used[p]];
        products(n, columns, in_use, weight, level, normal, right);
        for (int p = 0; p < columns; p++)
            normal[p][p] += 1e-6;
        /* A flat profile says nothing about the step: hold it. */
        normal[at_step][at_step] += 1e-3 / model->noise;
        if (blurred)
            normal[columns - 1][columns - 1] += 1e-3 / model->noise;
        /* What is known of the slopes: that outside of an edge, not that at the foot of a wall. */
        normal[at_step + 1][at_step + 1] += model->slope_inside_weight;
        right[at_step + 1] += model->slope_inside_weight * model->slope_inside;
        if (!with_wall) {
            normal[at_step + 2][at_step + 2] += model->slope_outside_weight;
            right[at_step + 2] += model->slope_outside_weight * model->slope_outside;
        }
        if (with_wall) {
            /* What is known of the wall: its grey is wall_ratio times that of the upper face. */
            const double expected = model->wall_ratio_sigma * inside;
            const double known = fmax(scatter, 1.0 / model->noise) / fmax(expected * expected, 1.0);
            normal[ON_WALL][ON_WALL] += known;
            normal[IN][IN] += known * wall_ratio * wall_ratio;
            normal[ON_WALL][IN] -= known * wall_ratio;
        }
        if (!factorise(columns, normal, diagonal)) {
            memset(result, 0, RESULT_FIELDS * sizeof(double));
            return;
        }
        solve(columns, normal, diagonal, right);
        memcpy(error, level, (size_t)n * sizeof(double));
        for (int p = 0; p < columns; p++) {
            const double *mine = column[used[p]], factor = right[p];
            for (int i = 0; i < n; i++)
                error[i] -= factor * mine[i];
        }
        double square = 0.0;
        for (int i = 0; i < n; i++)
            square += weight[i] * error[i] * error[i];
        scatter = square / fmax(filled - columns, 1);
        inside = right[IN];
        outside = right[OUT];
        grey_of_wall = with_wall ? right[ON_WALL] : wall_ratio * inside;
        const double change = fmin(fmax(right[at_step], -1.5), 1.5);
        double wider = 0.0;
        if (blurred) {
            wider = fmin(fmax(right[columns - 1] / s, -0.3), 0.3);
            s = fmin(fmax(s * (1.0 + wider), 0.3), 4.0);
        }
        step = fmin(fmax(step + change, -reach), reach);
        if (fabs(change) < CONVERGED_PX && fabs(wider) < CONVERGED_BLUR)
            break;
    }
    double on_slab = 0.0, on_table = 0.0, bins_on_slab = 0.0, bins_on_table = 0.0;
    for (int i = 0; i < n; i++) {
        const double away = depth[i] + step, square = count[i] * error[i] * error[i], here = count[i] > 0.0 ? 1.0 : 0.0;
        const int slab = away > BESIDE * s, beside = -away - strip > BESIDE * s;
        on_slab += slab ? square : 0.0;
        bins_on_slab += slab ? here : 0.0;
        on_table += beside ? square : 0.0;
        bins_on_table += beside ? here : 0.0;
    }
    const double usual = fmax(scatter, model->least_scatter);
    const double sigma = sqrt(fmax(inverse_at(columns, normal, diagonal, at_step) * usual, 1e-12));
    const double edge = fabs(inside - (strip > 2.0 * s ? grey_of_wall : outside));
    result[SHIFT] = step;
    result[SIGMA] = sigma;
    result[INSIDE] = inside;
    result[OUTSIDE] = outside;
    result[WALL_LEVEL] = grey_of_wall;
    result[VALID] = pixels >= 40 && sigma < 0.5 && fabs(step) < reach - 2.0 * s
                    && edge > fmax(4.0, 0.02 * fabs(inside));
    result[SCATTER] = scatter;
    result[SCATTER_INSIDE] = on_slab / fmax(bins_on_slab - 2.0, 1.0);
    result[SCATTER_OUTSIDE] = on_table / fmax(bins_on_table - 2.0, 1.0);
    result[BLUR] = s;
    result[SLOPE_INSIDE] = right[at_step + 1];
    result[SLOPE_OUTSIDE] = right[at_step + 2];
    result[SLOPE_INSIDE_VARIANCE] = inverse_at(columns, normal, diagonal, at_step + 1) * usual;
    result[SLOPE_OUTSIDE_VARIANCE] = inverse_at(columns, normal, diagonal, at_step + 2) * usual;
}

/* Bits of the sum of levels, and below the point of a place: what 64 bits have room for. */
#define PIXEL uint8_t
#define NAME(x) x##_u8
#define LEVEL_BITS 18
#define PLACE_BITS 18
#include "profile_pixels.h"
#undef PIXEL
#undef NAME
#undef LEVEL_BITS
#undef PLACE_BITS
#define PIXEL uint16_t
#define NAME(x) x##_u16
#define LEVEL_BITS 26
#define PLACE_BITS 10
#include "profile_pixels.h"
