/* Where do the outlines of the blobs run?  contours.py is the reference. */
#include "kernel.h"

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

/* The picture as one bit a pixel, 1 inside, with a rim of zeros: a word to the left and right, a row above and below. */
typedef struct {
    const uint8_t *image;
    ptrdiff_t stride;
    int width, height;
    uint64_t *bits, *seen;
    ptrdiff_t words; /* of a row, rim included */
    double level;
    int interpolate;
} Picture;

static inline int64_t bit_at(const Picture *p, int u, int v) { return (v + 1) * p->words * 64 + 64 + u; }

static inline int inside(const Picture *p, int64_t at) { return (int)(p->bits[at >> 6] >> (at & 63)) & 1; }

/* A bit for each of the next 64 pixels: whether it is above the limit. */
static inline uint64_t above(const uint8_t *row, uint8_t limit)
{
    uint64_t found = 0;
#if defined(__SSE2__)
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

static void to_bits(const Picture *p, uint8_t limit, int dark)
{
    memset(p->bits, 0, (size_t)p->words * sizeof(uint64_t));
    memset(p->bits + (p->height + 1) * p->words, 0, (size_t)p->words * sizeof(uint64_t));
    const uint64_t flip = dark ? ~(uint64_t)0 : 0;
    for (int v = 0; v < p->height; v++) {
        const uint8_t *row = p->image + v * p->stride;
        uint64_t *line = p->bits + (v + 1) * p->words;
        int u = 0;
        *line++ = 0;
        for (; u + 64 <= p->width; u += 64)
            *line++ = above(row + u, limit) ^ flip;
        if (u < p->width) {
            uint64_t last = 0;
            for (int i = 0; u + i < p->width; i++)
                last |= (uint64_t)((row[u + i] > limit) != dark) << i;
            *line++ = last;
        }
        while (line < p->bits + (v + 2) * p->words)
            *line++ = 0;
    }
}

/* Follows one border from the left side of a pixel; returns the number of its cracks.  The first `room` points are
 * written; `touches` tells whether a pixel of the picture's rim belongs to it. */
static int64_t follow(const Picture *p, int u0, int v0, double *points, int64_t room, int *touches)
{
    /* Left, up, right, down: outside of a crack; the walk goes on to the next in this order, clockwise as seen. */
    static const int step_u[4] = {-1, 0, 1, 0}, step_v[4] = {0, -1, 0, 1};
    /* After a left turn, straight on, a right turn: how the side changes. */
    static const int turn[3] = {3, 0, 1};
    const int64_t line = p->words * 64, step_bit[4] = {-1, -line, 1, line};
    const int64_t start = bit_at(p, u0, v0);
    const double half = 0.5;
    int u = u0, v = v0, side = 0, rim = 0;
    int64_t count = 0, at = start;
    do {
        const int du = step_u[side], dv = step_v[side], ahead = (side + 1) & 3;
        p->seen[at >> 6] |= (uint64_t)(side == 0) << (at & 63);
        const int out = (unsigned)(u + du) >= (unsigned)p->width || (unsigned)(v + dv) >= (unsigned)p->height;
        rim |= out;
        if (count < room) {
            double share = half;
            if (p->interpolate && !out) {
                const uint8_t *pixel = p->image + v * p->stride + u;
                const double mine = pixel[0], other = pixel[dv * p->stride + du];
                share = (mine - p->level) / (mine - other);
            }
            points[2 * count] = u + share * du;
            points[2 * count + 1] = v + share * dv;
        }
        count++;
        /* A pixel beside the corner belongs to the same blob if it touches it by the corner alone. */
        const int64_t next = at + step_bit[ahead], corner = next + step_bit[side];
        const int at_corner = inside(p, corner), straight = inside(p, next);
        const int how = at_corner ? 0 : straight ? 1 : 2;
        const int moves = at_corner | straight;
        u += moves * step_u[ahead] + at_corner * du;
        v += moves * step_v[ahead] + at_corner * dv;
        at = at_corner ? corner : straight ? next : at;
        side = (side + turn[how]) & 3;
    } while (at != start || side != 0);
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
 * and whether it touches the rim.  `scratch` has room for two pictures of bits, (height + 2)·words each, of words =
 * ceil(width / 64) + 2.  Returns the number of borders; `totals` says how many points they have together, and how many
 * smaller ones there were.  What does not fit into the rooms is counted but not written. */
int64_t slabcell_trace(const uint8_t *image, ptrdiff_t stride, int width, int height, double level, int dark,
                       int interpolate, double min_area, uint64_t *scratch, double *points, int64_t room,
                       int64_t *starts, double *areas, uint8_t *rims, int64_t borders_room, int64_t *totals)
{
    const ptrdiff_t words = (width + 63) / 64 + 2, all = words * (height + 2);
    const Picture picture = {image, stride, width, height, scratch, scratch + all, words, level, interpolate};
    int64_t used = 0, borders = 0, left_out = 0;
    totals[0] = totals[1] = 0;
    starts[0] = 0;
    if (!(level >= 0.0) || !(level < 255.0))
        return 0;
    to_bits(&picture, (uint8_t)floor(level), dark);
    memset(picture.seen, 0, (size_t)all * sizeof(uint64_t));
    for (int v = 0; v < height; v++) {
        const uint64_t *line = picture.bits + (v + 1) * words, *seen = picture.seen + (v + 1) * words;
        uint64_t before = 0;
        for (ptrdiff_t word = 1; word < words - 1; word++) {
            const uint64_t here = line[word], begins = here & ~(here << 1 | before >> 63);
            before = here;
            /* Following a border marks others of the same word: look again after each. */
            for (uint64_t left = begins & ~seen[word]; left;) {
                const int bit = __builtin_ctzll(left), u = (int)(word - 1) * 64 + bit;
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
