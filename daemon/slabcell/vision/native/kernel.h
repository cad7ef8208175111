/* What the parts of the compiled kernel share.  Plain C, no Python: loaded with ctypes by ../kernel.py.
 *
 * Every function here has a reference in Python that explains it, and that the tests hold it against.  All memory is
 * the caller's; nothing is kept between calls, so any number of threads may call.
 */
#ifndef SLABCELL_KERNEL_H
#define SLABCELL_KERNEL_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* As in kernel.py: a library of another version is refused. */
#define KERNEL_VERSION 9

/* Pictures are larger than the processor's cache: what will be read next is asked for early. */
#if defined(__GNUC__)
#define slabcell_prefetch(address) __builtin_prefetch(address)
#else
#define slabcell_prefetch(address) ((void)0)
#endif

#define TURN 6.283185307179586

/* Columns of the arrays that cross the border to Python. */
enum { PIECE_X, PIECE_Y, PIECE_TX, PIECE_TY, PIECE_HALF, PIECE_BEND, PIECE_FIELDS };
enum { POSE_ROTATION, POSE_X, POSE_Y, POSE_PIVOT_X, POSE_PIVOT_Y, POSE_KERF, POSE_FIELDS };
enum { LINE_U, LINE_V, LINE_NORMAL_U, LINE_NORMAL_V, LINE_HALF, LINE_BEND, LINE_WALL, LINE_FIELDS };
/* A map of the table to pixels: polynomials of so many terms, from local_map.py. */
#define TERMS 15
enum { MAP_X, MAP_Y, MAP_SIZE, MAP_TOP, MAP_FOOT = MAP_TOP + 2 * TERMS, MAP_FIELDS = MAP_FOOT + 2 * TERMS };
/* What a blob may be, as matching.Candidate. */
enum { CANDIDATE_BLOB, CANDIDATE_SLOT, CANDIDATE_ROTATION, CANDIDATE_X, CANDIDATE_Y, CANDIDATE_DISTANCE, CANDIDATE_FIELDS };
enum { ROW_X, ROW_Y, ROW_TURN, ROW_KERF, PX_PER_MM, SHARE, TABLE_X, TABLE_Y, EXTRA_FIELDS };
enum {
    SHIFT, SIGMA, INSIDE, OUTSIDE, WALL_LEVEL, VALID, SCATTER, SCATTER_INSIDE, SCATTER_OUTSIDE, BLUR,
    SLOPE_INSIDE, SLOPE_OUTSIDE, SLOPE_INSIDE_VARIANCE, SLOPE_OUTSIDE_VARIANCE, RESULT_FIELDS
};

/* The normal distribution on -TABLE_REACH ... TABLE_REACH in steps of 1/TABLE_STEPS: density and integral in turn. */
#define TABLE_REACH 7
#define TABLE_STEPS 64

/* What is known of every edge of a picture; the same order as in kernel.py. */
typedef struct {
    double sigma, reach, wall_ratio, wall_ratio_sigma, noise, grain_inside, grain_outside, grain_reach, least_scatter;
    double near, fit_blur, wall_light_u, wall_light_v;
    double slope_inside, slope_inside_weight, slope_outside, slope_outside_weight;
} Model;

void slabcell_project(int outlines, const int64_t *starts, const double *pieces, const double *poses,
                      const double *maps, int mirrored, double *lines, double *extras);
void slabcell_measure_edges_u8(const uint8_t *image, ptrdiff_t stride, int width, int height, int pieces,
                               const double *lines, const Model *model, const double *table, double *results);
void slabcell_measure_edges_u16(const uint16_t *image, ptrdiff_t stride, int width, int height, int pieces,
                                const double *lines, const Model *model, const double *table, double *results);
/* Where points of the table are seen: pixels of the upper plane and of the work plane below, (rows, columns, 4), for
 * points from (x0, y0) on, `pitch` mm apart. */
typedef struct {
    const double *grid;
    int rows, columns;
    double x0, y0, pitch;
    int flat; /* the upper plane is the work plane */
} Forward;

int slabcell_seen(const Forward *table, double x, double y, double pixels[4]);
int slabcell_to_pixels(const Forward *table, int64_t count, const double *points, double *pixels);
int slabcell_local_maps(const Forward *table, int count, const double *nodes, const double *inverse, int places,
                        const double *centres, const double *sizes, double *maps);
double slabcell_nth(double *values, int n, int k);
void slabcell_solve(int outlines, const int64_t *starts, const double *extras, const double *measured, double prior,
                    double *changes, double *covariances, double *spreads, double *remaining);

#endif
