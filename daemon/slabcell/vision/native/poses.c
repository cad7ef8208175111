/* How are registered slabs picked and placed?  part_poses.py is the reference. */
#include "kernel.h"

#define ARROW_PX 5.0
#define DEGREES (360.0 / TURN)

enum { CHOSEN_ROTATION, CHOSEN_X, CHOSEN_Y, CHOSEN_COVARIANCE, CHOSEN_FIELDS = CHOSEN_COVARIANCE + 9 };
enum {
    POSE_TURN, POSE_BACK_X, POSE_BACK_Y, POSE_PICK_X, POSE_PICK_Y, POSE_PLACE_X, POSE_PLACE_Y, POSE_U, POSE_V, POSE_ANGLE,
    POSE_SIGMA_X, POSE_SIGMA_Y, POSE_SIGMA_TURN, POSE_OUT_FIELDS
};

/* Of `count` chosen registrations, `chosen` (count, CHOSEN_FIELDS) for `slots`: writes `numbers` (count,
 * POSE_OUT_FIELDS) and the pixels of their outlines, one after the other.  `middles`, `points` (slots, 2), `orders`
 * (slots), `corners` and where those of each slot begin are the template's.  Returns 0 if the table does not hold them all. */
int slabcell_poses(const Forward *table, double scale, int count,
                    const int64_t *slots, const double *chosen, const double *middles, const double *points,
                    const double *orders, const double *corners, const int64_t *starts, double *numbers, double *pixels)
{
    double *outline = pixels;
    for (int i = 0; i < count; i++) {
        const double *given = chosen + CHOSEN_FIELDS * (ptrdiff_t)i, *covariance = given + CHOSEN_COVARIANCE;
        const double *middle = middles + 2 * slots[i], *point = points + 2 * slots[i];
        double *out = numbers + POSE_OUT_FIELDS * (ptrdiff_t)i;
        /* Of the motions that look alike, the one that turns least, about the middle of the slot. */
        const double c0 = cos(given[CHOSEN_ROTATION]), s0 = sin(given[CHOSEN_ROTATION]);
        const double x = c0 * middle[0] - s0 * middle[1] + given[CHOSEN_X];
        const double y = s0 * middle[0] + c0 * middle[1] + given[CHOSEN_Y];
        const double step = 360.0 / orders[slots[i]], whole = DEGREES * given[CHOSEN_ROTATION];
        const double turn = whole - step * nearbyint(whole / step);
        const double c = cos(turn / DEGREES), s = sin(turn / DEGREES);
        const double tx = x - (c * middle[0] - s * middle[1]), ty = y - (s * middle[0] + c * middle[1]);
        const double px = c * point[0] - s * point[1] + tx, py = s * point[0] + c * point[1] + ty;
        out[POSE_TURN] = turn;
        out[POSE_BACK_X] = -(c * tx + s * ty);
        out[POSE_BACK_Y] = -(c * ty - s * tx);
        out[POSE_PICK_X] = px;
        out[POSE_PICK_Y] = py;
        out[POSE_PLACE_X] = point[0];
        out[POSE_PLACE_Y] = point[1];
        const double arrow[4] = {px, py, px + ARROW_PX * scale * c, py + ARROW_PX * scale * s};
        double seen[4];
        if (!slabcell_to_pixels(table, 2, arrow, seen))
            return 0;
        out[POSE_U] = seen[0];
        out[POSE_V] = seen[1];
        out[POSE_ANGLE] = DEGREES * atan2(seen[1] - seen[3], seen[2] - seen[0]);
        const double right = px - x, up = py - y, tt = covariance[8];
        out[POSE_SIGMA_X] = sqrt(fmax(covariance[0] - 2.0 * up * covariance[2] + up * up * tt, 0.0));
        out[POSE_SIGMA_Y] = sqrt(fmax(covariance[4] + 2.0 * right * covariance[5] + right * right * tt, 0.0));
        out[POSE_SIGMA_TURN] = DEGREES * sqrt(fmax(tt, 0.0));
        for (int64_t k = starts[slots[i]]; k < starts[slots[i] + 1]; k++, outline += 2) {
            const double corner[2] = {c * corners[2 * k] - s * corners[2 * k + 1] + tx,
                                      s * corners[2 * k] + c * corners[2 * k + 1] + ty};
            if (!slabcell_to_pixels(table, 1, corner, outline))
                return 0;
        }
    }
    return 1;
}
