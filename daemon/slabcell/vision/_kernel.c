/* Where does the edge run, beside where it was expected?  The hot loop of edge_profile.py, which is its reference and
 * explains the model; both give the same numbers.  Plain C, no Python: loaded with ctypes by kernel.py.
 *
 * This file includes itself, once for each type of pixel.
 */
#ifndef PIXEL

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define BINS_PER_PX 4
#define MAX_BINS 256
#define COLUMNS 6
#define STEP 3
#define ITERATIONS 5
#define WIDE_WALL_PX 14.0
#define CONVERGED_PX 0.08
#define SQRT_2_PI 2.5066282746310002

/* The normal distribution on -TABLE_REACH ... TABLE_REACH in steps of 1/TABLE_STEPS, density and integral in turn. */
#define TABLE_REACH 7
#define TABLE_STEPS 64
#define TABLE_SIZE (2 * TABLE_REACH * TABLE_STEPS + 1)

/* One fat function per CPU generation, chosen when the library is loaded. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__gnu_linux__)
#define FOR_EVERY_CPU __attribute__((target_clones("arch=haswell", "default")))
#else
#define FOR_EVERY_CPU
#endif

typedef struct {
    double sigma, reach, wall_ratio, wall_ratio_sigma;
    int near;
} Model;

/* Columns of the arrays that cross the border to Python. */
enum { MIDDLE_U, MIDDLE_V, OUTWARD_U, OUTWARD_V, HALF, BEND, WALL, LINE_FIELDS };
enum { SHIFT, SIGMA, INSIDE, OUTSIDE, WALL_LEVEL, VALID, SCATTER, RESULT_FIELDS };

int slabcell_kernel_version(void) { return 4; }

static inline void normal_distribution(const double *table, double x, double *density, double *integral)
{
    if (x <= -TABLE_REACH) {
        *density = 0.0;
        *integral = 0.0;
        return;
    }
    if (x >= TABLE_REACH) {
        *density = 0.0;
        *integral = 1.0;
        return;
    }
    double at = (x + TABLE_REACH) * TABLE_STEPS;
    int index = (int)(at + 0.5);
    double node = (double)index / TABLE_STEPS - TABLE_REACH;
    double h = x - node;
    double f = table[2 * index];
    /* Taylor about the nearest node; the remainder is below 1e-9. */
    *density = f * (1.0 - node * h + 0.5 * (node * node - 1.0) * h * h);
    *integral = table[2 * index + 1] + f * h * (1.0 - 0.5 * node * h + (node * node - 1.0) * h * h / 6.0);
}

/* Solves a symmetric positive definite system in place; `inverse_at` gives one diagonal element of the inverse. */
static int solve(double a[COLUMNS][COLUMNS], double b[COLUMNS], int inverse_at, double *inverse)
{
    double unit[COLUMNS] = {0};
    unit[inverse_at] = 1.0;
    for (int i = 0; i < COLUMNS; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = a[i][j];
            for (int k = 0; k < j; k++)
                sum -= a[i][k] * a[j][k];
            if (i == j) {
                if (!(sum > 0.0))
                    return 0;
                a[i][i] = sqrt(sum);
            } else {
                a[i][j] = sum / a[j][j];
            }
        }
    }
    double norm = 0.0;
    for (int i = 0; i < COLUMNS; i++) {
        double sum = b[i], other = unit[i];
        for (int k = 0; k < i; k++) {
            sum -= a[i][k] * b[k];
            other -= a[i][k] * unit[k];
        }
        b[i] = sum / a[i][i];
        unit[i] = other / a[i][i];
        norm += unit[i] * unit[i];
    }
    *inverse = norm;
    for (int i = COLUMNS - 1; i >= 0; i--) {
        double sum = b[i];
        for (int k = i + 1; k < COLUMNS; k++)
            sum -= a[k][i] * b[k];
        b[i] = sum / a[i][i];
    }
    return 1;
}

static double mean_between(int n, const double *count, const double *depth, const double *level, double low, double high)
{
    double weight = 0.0, sum = 0.0;
    for (int i = 0; i < n; i++)
        if (depth[i] > low && depth[i] < high) {
            weight += count[i];
            sum += count[i] * level[i];
        }
    return sum / fmax(weight, 1.0);
}

/* Fits the model to one profile of n bins that hold pixels. */
FOR_EVERY_CPU
static void fit(int n, const double *restrict count, const double *restrict depth, const double *restrict level,
                double wall, const Model *model, const double *table, double *result)
{
    const double s = model->sigma, reach = model->reach;
    const int wide = wall > WIDE_WALL_PX;
    const double strip = wide ? 0.0 : wall;
    const double outer = wide ? WIDE_WALL_PX - 2.0 : wall + reach;
    double column[COLUMNS][MAX_BINS];
    double pixels = 0.0, deepest = 0.0;

    double inside = mean_between(n, count, depth, level, reach - 2.0, 1e9);
    double outside = mean_between(n, count, depth, level, -1e9, -(outer - 2.0));
    double grey_of_wall = model->wall_ratio * inside;

    double contrast = inside - outside;
    if (fabs(contrast) < 1.0)
        contrast = 1.0;
    double share = 0.0;
    for (int i = 0; i < n; i++) {
        pixels += count[i];
        share += count[i] * (level[i] - outside) / contrast;
        deepest = fmax(deepest, -depth[i]);
    }
    share /= fmax(pixels, 1.0);
    double wall_light = strip * fmin(fmax((grey_of_wall - outside) / contrast, 0.0), 1.0);
    double step = model->near ? 0.0 : fmin(fmax(share * (deepest + reach) - reach - wall_light, 3.0 - reach), reach - 3.0);

    double variance = 0.0, spread = 1e6;
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
        for (int i = 0; i < n; i++) {
            double near = (depth[i] + step) / s, bell_near, upper, bell_far, both;
            normal_distribution(table, near, &bell_near, &upper);
            if (strip > 0.0) {
                normal_distribution(table, near + strip / s, &bell_far, &both);
            } else {
                bell_far = bell_near;
                both = upper;
            }
            column[0][i] = upper;
            column[1][i] = 1.0 - both;
            column[2][i] = both - upper;
            column[3][i] = ((inside - grey_of_wall) * bell_near + (grey_of_wall - outside) * bell_far) / s;
            column[4][i] = depth[i] * upper;
            column[5][i] = depth[i] * (1.0 - both);
        }
        double normal[COLUMNS][COLUMNS], right[COLUMNS];
        for (int p = 0; p < COLUMNS; p++) {
            if (p == 2 && !(strip > 0.0)) { /* no wall, an empty column */
                memset(normal[2], 0, sizeof normal[2]);
                right[2] = 0.0;
                continue;
            }
            double weighted[MAX_BINS];
            for (int i = 0; i < n; i++)
                weighted[i] = count[i] * column[p][i];
            double sum = 0.0;
            for (int i = 0; i < n; i++)
                sum += weighted[i] * level[i];
            right[p] = sum;
            for (int q = 0; q <= p; q++) {
                double product = 0.0;
                for (int i = 0; i < n; i++)
                    product += weighted[i] * column[q][i];
                normal[p][q] = product;
            }
        }
        double expected = model->wall_ratio_sigma * inside;
        double known = fmax(variance, 1.0) / fmax(expected * expected, 1.0);
        normal[2][2] += known;
        normal[0][0] += known * model->wall_ratio * model->wall_ratio;
        normal[2][0] -= known * model->wall_ratio;
        for (int p = 0; p < COLUMNS; p++)
            normal[p][p] += 1e-6;
        normal[STEP][STEP] += 1e-3;
        if (!solve(normal, right, STEP, &spread)) {
            memset(result, 0, RESULT_FIELDS * sizeof(double));
            return;
        }
        double square = 0.0;
        for (int i = 0; i < n; i++) {
            double error = level[i];
            for (int p = 0; p < COLUMNS; p++)
                error -= right[p] * column[p][i];
            square += count[i] * error * error;
        }
        variance = square / fmax(n - COLUMNS, 1);
        inside = right[0];
        outside = right[1];
        grey_of_wall = right[2];
        double change = fmin(fmax(right[STEP], -1.5), 1.5);
        step = fmin(fmax(step + change, -reach), reach);
        if (fabs(change) < CONVERGED_PX)
            break;
    }
    double sigma = sqrt(fmax(spread * fmax(variance, 0.25), 1e-12));
    int from_wall = strip > 2.0 * s;
    contrast = fabs(inside - (from_wall ? grey_of_wall : outside));
    result[SHIFT] = step;
    result[SIGMA] = sigma;
    result[INSIDE] = inside;
    result[OUTSIDE] = outside;
    result[WALL_LEVEL] = grey_of_wall;
    result[SCATTER] = variance;
    result[VALID] = pixels >= 40 && sigma < 0.5 && fabs(step) < reach - 2.0 * s
                    && contrast > fmax(4.0, 0.02 * fabs(inside));
}

/* ---- Where pieces of outlines are seen (edge_projection.py is the reference) ---- */

#define DEGREE 4
#define TERMS 15
enum { PIECE_X, PIECE_Y, PIECE_TX, PIECE_TY, PIECE_HALF, PIECE_BEND, PIECE_FIELDS };
enum { POSE_ROTATION, POSE_X, POSE_Y, POSE_PIVOT_X, POSE_PIVOT_Y, POSE_KERF, POSE_FIELDS };
enum { MAP_X, MAP_Y, MAP_SIZE, MAP_TOP, MAP_FOOT = MAP_TOP + 2 * TERMS, MAP_FIELDS = MAP_FOOT + 2 * TERMS };
enum { ROW_X, ROW_Y, ROW_TURN, ROW_KERF, PX_PER_MM, SHARE, TABLE_X, TABLE_Y, EXTRA_FIELDS };

/* The terms x^i y^j in the order of local_map.TERMS, and their derivatives. */
static void terms(double x, double y, double *value, double *by_x, double *by_y)
{
    double xs[DEGREE + 1] = {1.0}, ys[DEGREE + 1] = {1.0};
    for (int i = 0; i < DEGREE; i++) {
        xs[i + 1] = xs[i] * x;
        ys[i + 1] = ys[i] * y;
    }
    int term = 0;
    for (int total = 0; total <= DEGREE; total++)
        for (int j = 0; j <= total; j++, term++) {
            int i = total - j;
            value[term] = xs[i] * ys[j];
            if (by_x) {
                by_x[term] = i ? i * xs[i - 1] * ys[j] : 0.0;
                by_y[term] = j ? j * xs[i] * ys[j - 1] : 0.0;
            }
        }
}

static inline void dot(const double *coefficients, const double *term, double *u, double *v)
{
    double a = 0.0, b = 0.0;
    for (int i = 0; i < TERMS; i++) {
        a += coefficients[2 * i] * term[i];
        b += coefficients[2 * i + 1] * term[i];
    }
    *u = a;
    *v = b;
}

void slabcell_project(int outlines, const int64_t *starts, const double *pieces, const double *poses,
                      const double *maps, int mirrored, double *lines, double *extras)
{
    for (int o = 0; o < outlines; o++) {
        const double *pose = poses + POSE_FIELDS * (ptrdiff_t)o, *map = maps + MAP_FIELDS * (ptrdiff_t)o;
        const double c = cos(pose[POSE_ROTATION]), s = sin(pose[POSE_ROTATION]), size = map[MAP_SIZE];
        double length = 0.0;
        for (int64_t p = starts[o]; p < starts[o + 1]; p++)
            length += pieces[PIECE_FIELDS * p + PIECE_HALF];
        for (int64_t p = starts[o]; p < starts[o + 1]; p++) {
            const double *piece = pieces + PIECE_FIELDS * p;
            double *line = lines + LINE_FIELDS * p, *extra = extras + EXTRA_FIELDS * p;
            const double dx = piece[PIECE_X] - pose[POSE_PIVOT_X], dy = piece[PIECE_Y] - pose[POSE_PIVOT_Y];
            const double ax = c * dx - s * dy, ay = s * dx + c * dy;
            const double tx = c * piece[PIECE_TX] - s * piece[PIECE_TY], ty = s * piece[PIECE_TX] + c * piece[PIECE_TY];
            const double nx = ty, ny = -tx, half = piece[PIECE_HALF];
            const double x = pose[POSE_X] + ax + pose[POSE_KERF] * nx, y = pose[POSE_Y] + ay + pose[POSE_KERF] * ny;
            const double px = (x - map[MAP_X]) / size, py = (y - map[MAP_Y]) / size;
            const double bulge = piece[PIECE_BEND] * half * half;
            double value[TERMS], by_x[TERMS], by_y[TERMS];
            double u, v, u0, v0, u1, v1, uf, vf, ux, vx, uy, vy;
            terms(px + (-half * tx + bulge * nx) / size, py + (-half * ty + bulge * ny) / size, value, NULL, NULL);
            dot(map + MAP_TOP, value, &u0, &v0);
            terms(px + (half * tx + bulge * nx) / size, py + (half * ty + bulge * ny) / size, value, NULL, NULL);
            dot(map + MAP_TOP, value, &u1, &v1);
            terms(px, py, value, by_x, by_y);
            dot(map + MAP_TOP, value, &u, &v);
            dot(map + MAP_FOOT, value, &uf, &vf);
            dot(map + MAP_TOP, by_x, &ux, &vx);
            dot(map + MAP_TOP, by_y, &uy, &vy);
            const double chord = fmax(hypot(u1 - u0, v1 - v0), 1e-9), side = mirrored ? -1.0 : 1.0;
            const double nu = side * (v1 - v0) / chord, nv = -side * (u1 - u0) / chord;
            const double sag = nu * (0.5 * (u0 + u1) - u) + nv * (0.5 * (v0 + v1) - v);
            line[MIDDLE_U] = u;
            line[MIDDLE_V] = v;
            line[OUTWARD_U] = nu;
            line[OUTWARD_V] = nv;
            line[HALF] = 0.5 * chord;
            line[BEND] = sag / (0.25 * chord * chord);
            line[WALL] = fmax(nu * (uf - u) + nv * (vf - v), 0.0);
            extra[ROW_X] = nx;
            extra[ROW_Y] = ny;
            extra[ROW_TURN] = ny * ax - nx * ay;
            extra[ROW_KERF] = 1.0;
            extra[PX_PER_MM] = (nu * (nx * ux + ny * uy) + nv * (nx * vx + ny * vy)) / size;
            extra[SHARE] = half / fmax(length, 1e-9);
            extra[TABLE_X] = x;
            extra[TABLE_Y] = y;
        }
    }
}

/* ---- The pose that explains measured pieces (registration.py is the reference) ---- */

#define UNKNOWNS 4
#define ROBUST_STEPS 6
#define TUKEY 4.7
#define MAX_PIECES 4096

static int invert(double a[UNKNOWNS][UNKNOWNS], double inverse[UNKNOWNS][UNKNOWNS])
{
    for (int i = 0; i < UNKNOWNS; i++)
        for (int j = 0; j < UNKNOWNS; j++)
            inverse[i][j] = i == j;
    for (int i = 0; i < UNKNOWNS; i++) {
        if (!(a[i][i] > 0.0))
            return 0;
        const double pivot = 1.0 / a[i][i];
        for (int j = 0; j < UNKNOWNS; j++) {
            a[i][j] *= pivot;
            inverse[i][j] *= pivot;
        }
        for (int k = 0; k < UNKNOWNS; k++) {
            if (k == i)
                continue;
            const double factor = a[k][i];
            for (int j = 0; j < UNKNOWNS; j++) {
                a[k][j] -= factor * a[i][j];
                inverse[k][j] -= factor * inverse[i][j];
            }
        }
    }
    return 1;
}

/* The element that sorting would bring to place k; reorders the values. */
static double nth(double *values, int n, int k)
{
    int low = 0, high = n - 1;
    while (low < high) {
        const double pivot = values[(low + high) / 2];
        int i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot)
                i++;
            while (values[j] > pivot)
                j--;
            if (i <= j) {
                const double swap = values[i];
                values[i++] = values[j];
                values[j--] = swap;
            }
        }
        if (k <= j)
            high = j;
        else if (k >= i)
            low = i;
        else
            break;
    }
    return values[k];
}

/* `measured` holds distance (mm), sigma (mm) and valid of each piece; `changes` (outlines, 4), `covariances`
 * (outlines, 4, 4) and `remaining` (pieces) are written. */
void slabcell_solve(int outlines, const int64_t *starts, const double *extras, const double *measured, double prior,
                    double *changes, double *covariances, double *remaining)
{
    static const double nothing[UNKNOWNS] = {0};
    for (int o = 0; o < outlines; o++) {
        const int64_t first = starts[o];
        const int n = (int)(starts[o + 1] - first);
        const double *row = extras + EXTRA_FIELDS * first, *given = measured + 3 * first;
        double *left = remaining + first, *change = changes + UNKNOWNS * (ptrdiff_t)o;
        double *covariance = covariances + UNKNOWNS * UNKNOWNS * (ptrdiff_t)o;
        double weight[MAX_PIECES], sorted[MAX_PIECES];
        double arm = 1.0, spread = 0.5;
        double inverse[UNKNOWNS][UNKNOWNS];
        memcpy(change, nothing, sizeof nothing);
        memset(covariance, 0, sizeof inverse);
        if (n > MAX_PIECES)
            continue;
        for (int i = 0; i < n; i++) {
            arm = fmax(arm, fabs(row[EXTRA_FIELDS * i + ROW_TURN]));
            weight[i] = given[3 * i + 2] > 0.5 ? 1.0 / (given[3 * i + 1] * given[3 * i + 1]) : 0.0;
            left[i] = given[3 * i];
        }
        for (int step = 0; step < ROBUST_STEPS; step++) {
            double normal[UNKNOWNS][UNKNOWNS] = {{0}}, right[UNKNOWNS] = {0};
            for (int i = 0; i < n; i++) {
                const double *r = row + EXTRA_FIELDS * i;
                const double scaled[UNKNOWNS] = {r[ROW_X], r[ROW_Y], r[ROW_TURN] / arm, r[ROW_KERF]};
                for (int p = 0; p < UNKNOWNS; p++) {
                    const double w = weight[i] * scaled[p];
                    right[p] += w * given[3 * i];
                    for (int q = 0; q <= p; q++)
                        normal[p][q] += w * scaled[q];
                }
            }
            for (int p = 0; p < UNKNOWNS; p++) {
                for (int q = 0; q < p; q++)
                    normal[q][p] = normal[p][q];
                normal[p][p] += prior;
            }
            if (!invert(normal, inverse))
                break;
            for (int p = 0; p < UNKNOWNS; p++) {
                change[p] = 0.0;
                for (int q = 0; q < UNKNOWNS; q++)
                    change[p] += inverse[p][q] * right[q];
            }
            int usable = 0;
            for (int i = 0; i < n; i++) {
                const double *r = row + EXTRA_FIELDS * i;
                left[i] = given[3 * i]
                          - (r[ROW_X] * change[0] + r[ROW_Y] * change[1] + r[ROW_TURN] / arm * change[2] + change[3]);
                if (given[3 * i + 2] > 0.5)
                    sorted[usable++] = fabs(left[i]) / given[3 * i + 1];
            }
            spread = fmax((usable ? nth(sorted, usable, usable / 2 < usable ? usable / 2 : usable - 1) : 0.0) / 0.6745, 0.5);
            const double cut = TUKEY * fmax(spread, 1.0);
            for (int i = 0; i < n; i++) {
                const double sigma = given[3 * i + 1], away = fabs(left[i]) / sigma / cut;
                const double robust = fmax(1.0 - away * away, 0.0);
                weight[i] = given[3 * i + 2] > 0.5 ? robust * robust / (sigma * sigma) : 0.0;
            }
        }
        const double unscale[UNKNOWNS] = {1.0, 1.0, 1.0 / arm, 1.0}, chi = fmax(spread * spread, 1.0);
        for (int p = 0; p < UNKNOWNS; p++) {
            for (int q = 0; q < UNKNOWNS; q++)
                covariance[UNKNOWNS * p + q] = inverse[p][q] * chi * unscale[p] * unscale[q];
        }
        for (int p = 0; p < UNKNOWNS; p++)
            change[p] *= unscale[p];
    }
}

#define PIXEL uint8_t
#define NAME(x) x##_u8
#include "_kernel.c"
#undef PIXEL
#undef NAME
#define PIXEL uint16_t
#define NAME(x) x##_u16
#include "_kernel.c"

#else

/* Sorts the pixels near one piece of edge into bins, and fits their profile. */
static void NAME(measure_one)(const PIXEL *image, ptrdiff_t stride, int width, int height, const double *line,
                              const Model *model, const double *table, double *result)
{
    const double reach = model->reach, half = line[HALF], bend = line[BEND], wall = line[WALL];
    const double outer = wall > WIDE_WALL_PX ? WIDE_WALL_PX - 2.0 : wall + reach;
    const int offset = (int)ceil(outer);
    int bins = (int)ceil((offset + reach) * BINS_PER_PX) + 1;
    double count[MAX_BINS] = {0}, depths[MAX_BINS] = {0}, levels[MAX_BINS] = {0};

    memset(result, 0, RESULT_FIELDS * sizeof(double));
    if (bins > MAX_BINS || !(half > 0.0) || !(half < 1e4) || !(fabs(bend) < 1.0))
        return;
    /* Scan along the axis that the edge follows more closely. */
    const int along_u = fabs(line[OUTWARD_V]) >= fabs(line[OUTWARD_U]);
    const double t_major = along_u ? -line[OUTWARD_V] : line[OUTWARD_U];
    const double t_minor = along_u ? line[OUTWARD_U] : -line[OUTWARD_V];
    const double n_major = along_u ? line[OUTWARD_U] : line[OUTWARD_V];
    const double n_minor = along_u ? line[OUTWARD_V] : line[OUTWARD_U];
    const double mid_major = along_u ? line[MIDDLE_U] : line[MIDDLE_V];
    const double mid_minor = along_u ? line[MIDDLE_V] : line[MIDDLE_U];
    const int size_major = along_u ? width : height, size_minor = along_u ? height : width;
    const ptrdiff_t next = along_u ? stride : 1, next_major = along_u ? 1 : stride;
    const double slack = fabs(bend) * half * half + 1e-9;
    const double extent = half * fabs(t_major) + (fmax(outer, reach) + slack) * fabs(n_major);
    if (!(fabs(mid_major) < 1e6) || !(fabs(mid_minor) < 1e6))
        return;
    int first = (int)ceil(mid_major - extent), last = (int)floor(mid_major + extent);
    if (first < 0)
        first = 0;
    if (last > size_major - 1)
        last = size_major - 1;
    for (int a = first; a <= last; a++) {
        const double da = a - mid_major;
        /* Where this scan line crosses the strip, and where it leaves the piece's length. */
        double low = (-da * n_major - reach - slack) / n_minor, high = (-da * n_major + outer + slack) / n_minor;
        if (low > high) {
            double swap = low;
            low = high;
            high = swap;
        }
        if (fabs(t_minor) > 1e-12) {
            double from = (-half - da * t_major) / t_minor, to = (half - da * t_major) / t_minor;
            if (from > to) {
                double swap = from;
                from = to;
                to = swap;
            }
            low = fmax(low, from);
            high = fmin(high, to);
        } else if (fabs(da * t_major) > half) {
            continue;
        }
        int begin = (int)ceil(fmax(mid_minor + low - 1e-9, 0.0));
        int end = (int)floor(fmin(mid_minor + high + 1e-9, size_minor - 1.0));
        const PIXEL *pixel = image + a * next_major + begin * next;
        for (int b = begin; b <= end; b++, pixel += next) {
            const double db = b - mid_minor;
            const double t = da * t_major + db * t_minor;
            const double depth = bend * t * t - da * n_major - db * n_minor;
            if (!(fabs(t) <= half) || !(depth < reach) || !(depth >= -outer))
                continue;
            const int bin = (int)((depth + offset) * BINS_PER_PX);
            count[bin] += 1.0;
            depths[bin] += depth;
            levels[bin] += *pixel;
        }
    }
    int filled = 0;
    for (int bin = 0; bin < bins; bin++)
        if (count[bin] > 0.0) {
            const double number = count[bin];
            depths[filled] = depths[bin] / number;
            levels[filled] = levels[bin] / number;
            count[filled] = number;
            filled++;
        }
    if (filled > COLUMNS)
        fit(filled, count, depths, levels, wall, model, table, result);
}

void NAME(slabcell_measure_edges)(const PIXEL *image, ptrdiff_t stride, int width, int height, int pieces,
                                  const double *lines, const double *parameters, const double *table, double *results)
{
    const Model model = {parameters[0], parameters[1], parameters[2], parameters[3], parameters[4] != 0.0};
    for (int i = 0; i < pieces; i++)
        NAME(measure_one)(image, stride, width, height, lines + LINE_FIELDS * (ptrdiff_t)i, &model, table,
                          results + RESULT_FIELDS * (ptrdiff_t)i);
}

#endif
