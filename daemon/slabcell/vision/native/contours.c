/* Where do the outlines of the blobs run?  contours.py is the reference. */
#include "kernel.h"

#if defined(__AVX2__)
#include <immintrin.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#endif

#define AHEAD 16

typedef struct {
    const uint8_t *image;
    ptrdiff_t stride;
    int width, height;
    int limit, dark; /* a pixel is inside above the limit, or not above it */
    double level;
    int interpolate;
    uint64_t *seen; /* a bit for each pixel of the rows on which regions are found */
    ptrdiff_t words;
    int shift; /* those are every 2^shift-th */
} Picture;

static inline int inside_at(const Picture *p, const uint8_t *pixel) { return (*pixel > p->limit) != p->dark; }

static inline int inside(const Picture *p, int u, int v)
{
    return (unsigned)u < (unsigned)p->width && (unsigned)v < (unsigned)p->height
           && inside_at(p, p->image + v * p->stride + u);
}

/* A bit for each of the next 64 pixels: whether it is above the limit. */
static inline uint64_t above(const uint8_t *row, uint8_t limit)
{
    uint64_t found = 0;
#if defined(__AVX2__)
    const __m256i level = _mm256_set1_epi8((char)limit), zero = _mm256_setzero_si256();
    for (int i = 0; i < 2; i++) {
        const __m256i over = _mm256_subs_epu8(_mm256_loadu_si256((const __m256i *)(const void *)(row + 32 * i)), level);
        const uint32_t not_over = (uint32_t)_mm256_movemask_epi8(_mm256_cmpeq_epi8(over, zero));
        found |= (uint64_t)(uint32_t)~not_over << (32 * i);
    }
#elif defined(__SSE2__)
    const __m128i level = _mm_set1_epi8((char)limit), zero = _mm_setzero_si128();
    for (int i = 0; i < 4; i++) {
        const __m128i over = _mm_subs_epu8(_mm_loadu_si128((const __m128i *)(const void *)(row + 16 * i)), level);
        const uint32_t not_over = (uint32_t)_mm_movemask_epi8(_mm_cmpeq_epi8(over, zero));
        found |= (uint64_t)(~not_over & 0xffffu) << (16 * i);
    }
#else
    for (int i = 0; i < 64; i++)
        found |= (uint64_t)(row[i] > limit) << i;
#endif
    return found;
}

/* A bit for each of at most 64 pixels from `u` on: whether it is inside. */
static inline uint64_t bits_of(const Picture *p, const uint8_t *row, int u)
{
    if (u + 64 <= p->width)
        return above(row + u, (uint8_t)p->limit) ^ (p->dark ? ~(uint64_t)0 : 0);
    uint64_t found = 0;
    for (int i = 0; u + i < p->width; i++)
        found |= (uint64_t)inside_at(p, row + u + i) << i;
    return found;
}

/* Follows one border from the left side of a pixel; returns the number of its cracks.  The first `room` points are
 * written; `touches` tells whether a pixel of the picture's rim belongs to it. */
static int64_t follow(const Picture *p, int u0, int v0, double *points, int64_t room, int *touches)
{
    /* Left, up, right, down: outside of a crack; the walk goes on to the next in this order, clockwise as seen. */
    static const int step_u[4] = {-1, 0, 1, 0}, step_v[4] = {0, -1, 0, 1};
    /* After a left turn, straight on, a right turn: how the side changes. */
    static const int turn[3] = {3, 0, 1};
    const ptrdiff_t step[4] = {-1, -p->stride, 1, p->stride};
    const int found_on = (1 << p->shift) - 1;
    const uint8_t *pixel = p->image + v0 * p->stride + u0;
    const uint8_t *passed[AHEAD]; /* where the walk was AHEAD cracks ago: it will soon be as far on */
    for (int i = 0; i < AHEAD; i++)
        passed[i] = pixel;
    int u = u0, v = v0, side = 0, rim = 0;
    int64_t count = 0;
    do {
        slabcell_prefetch(pixel + (pixel - passed[count % AHEAD]));
        passed[count % AHEAD] = pixel;
        const int du = step_u[side], dv = step_v[side], ahead = (side + 1) & 3;
        const int on = side == 0 && !(v & found_on);
        p->seen[(v >> p->shift) * p->words + (u >> 6)] |= (uint64_t)on << (u & 63);
        /* A pixel beside the corner belongs to the same blob if it touches it by the corner alone. */
        int at_corner, straight, out = 0;
        if (u > 0 && v > 0 && u < p->width - 1 && v < p->height - 1) {
            at_corner = inside_at(p, pixel + step[ahead] + step[side]);
            straight = inside_at(p, pixel + step[ahead]);
        } else {
            out = (unsigned)(u + du) >= (unsigned)p->width || (unsigned)(v + dv) >= (unsigned)p->height;
            at_corner = inside(p, u + step_u[ahead] + du, v + step_v[ahead] + dv);
            straight = inside(p, u + step_u[ahead], v + step_v[ahead]);
        }
        rim |= out;
        if (count < room) {
            double share = 0.5;
            if (p->interpolate && !out) {
                const double mine = *pixel, other = pixel[step[side]];
                share = (mine - p->level) / (mine - other);
            }
            points[2 * count] = u + share * du;
            points[2 * count + 1] = v + share * dv;
        }
        count++;
        const int how = at_corner ? 0 : straight ? 1 : 2, moves = at_corner | straight;
        u += moves * step_u[ahead] + at_corner * du;
        v += moves * step_v[ahead] + at_corner * dv;
        pixel += moves * step[ahead] + at_corner * step[side];
        side = (side + turn[how]) & 3;
    } while (u != u0 || v != v0 || side != 0);
    *touches = rim;
    return count;
}

static double twice_area(const double *points, int64_t count)
{
    double sum = 0.0;
    const double u0 = points[0], v0 = points[1];
    double u = points[2 * count - 2] - u0, v = points[2 * count - 1] - v0;
    for (int64_t i = 0; i < count; i++) {
        const double un = points[2 * i] - u0, vn = points[2 * i + 1] - v0;
        sum += u * vn - un * v;
        u = un;
        v = vn;
    }
    return sum;
}

/* Writes the outer borders that enclose at least `min_area` pixels: `points`, and for each where it begins, its area
 * and whether it touches the rim.  Regions are found on every 2^shift-th row.  `scratch` has room for ceil(width / 64)
 * words of each of those.  Returns the number of borders; `totals` says how many points they have together, and how many
 * smaller ones there were.  What does not fit into the rooms is counted but not written. */
int64_t slabcell_trace(const uint8_t *image, ptrdiff_t stride, int width, int height, double level, int dark,
                       int interpolate, double min_area, int shift, uint64_t *scratch, double *points, int64_t room,
                       int64_t *starts, double *areas, uint8_t *rims, int64_t borders_room, int64_t *totals)
{
    const ptrdiff_t words = (width + 63) / 64;
    const Picture picture = {image, stride, width, height, (int)floor(level), dark, level, interpolate, scratch, words, shift};
    int64_t used = 0, borders = 0, left_out = 0;
    totals[0] = totals[1] = 0;
    starts[0] = 0;
    if (!(level >= 0.0) || !(level < 255.0))
        return 0;
    memset(scratch, 0, (size_t)(words * (((height - 1) >> shift) + 1)) * sizeof(uint64_t));
    for (int v = 0; v < height; v += 1 << shift) {
        const uint8_t *row = image + v * stride;
        const uint64_t *seen = scratch + (v >> shift) * words;
        uint64_t before = 0;
        for (ptrdiff_t word = 0; word < words; word++) {
            const uint64_t here = bits_of(&picture, row, (int)word * 64), begins = here & ~(here << 1 | before >> 63);
            before = here;
            /* Following a border marks others of the same word: look again after each. */
            for (uint64_t left = begins & ~seen[word]; left;) {
                const int bit = __builtin_ctzll(left), u = (int)word * 64 + bit;
                int touches = 0;
                double *mine = points + 2 * used;
                const int64_t space = used < room ? room - used : 0;
                const int64_t count = follow(&picture, u, v, mine, space, &touches);
                /* An outline of n cracks encloses at most (n/4)² pixels: this spares the grains of noise. */
                const double most = 0.0625 * (double)count * (double)count;
                if (most < min_area) {
                    left_out++;
                } else if (count > space) {
                    used += count; /* its area is not known: there must be room for it */
                    borders++;
                } else {
                    const double area = 0.5 * twice_area(mine, count);
                    if (area >= min_area) {
                        used += count;
                        if (borders < borders_room) {
                            areas[borders] = area;
                            rims[borders] = (uint8_t)touches;
                            starts[borders + 1] = used;
                        }
                        borders++;
                    } else if (area > 0.0) {
                        left_out++;
                    }
                }
                left = begins & ~seen[word] & ~((((uint64_t)1 << bit) << 1) - 1);
            }
        }
    }
    totals[0] = used;
    totals[1] = left_out;
    return borders;
}
