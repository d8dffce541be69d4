// Step II, second pass: the few rays with a near miss or an open bracket, walked cell by cell. Between two cell faces
// the field along a ray is a cubic (a little more inside boxes), so that its dips are found without stepping finely.
layout(local_size_x = 64) in;
#include "lib/cubic.glsl"
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"

const int MAX_CELLS = 3000;     // a ray through all cells of the body grid and the boxes of 128 voxels
const int CLOSE_STEPS = 24;

// t of the next face of the unit lattice after t, for a ray in voxels.
float next_face(vec3 origin, vec3 direction, float t) {
    vec3 safe = mix(direction, vec3(1e-12), lessThan(abs(direction), vec3(1e-12)));
    vec3 place = origin + t * safe;
    vec3 face = mix(ceil(place) - 1, floor(place) + 1, greaterThan(safe, vec3(0)));
    vec3 t_face = (face - origin) / safe;
    return max(min(t_face.x, min(t_face.y, t_face.z)), t);
}

float cell_end(Ray ray, float t, PartTruths inside) {
    float end = min(ray.range.y, t + max(reach_at(ray, t), 1e-6));
    float cut = BRICKS == 1 && brick_of(cell_of(body_at(ray, t + 1e-6))) >= 0 ? u_brick_side : 1.0;
    end = min(end, next_face(cut * ray.body_origin, cut * ray.body_direction, t));
    for (int k = 0; k < PART_COUNT; ++k) {
        if (!inside[k]) continue;
        float voxel = in_part[k].voxel;
        end = min(end, next_face(box_place(k, ray.origin) / voxel,
                                 mat3(in_part[k].box_from_root) * ray.direction / voxel, t));
        if (ray.exit[k] > t) end = min(end, ray.exit[k]);
    }
    return max(end, t + 2e-6);  // float resolution at a metre: always go on
}

void main() {
    uint row = listed(LIST_EXACT, gl_GlobalInvocationID.x);
    if (row == NO_SLOT) return;
    Suspect suspect = suspects[row];
    uvec2 pixel = place_of(suspect.pixel);
    uint index = index_of(pixel);
    Ray ray = ray_through(centre_of(pixel));
    float t = max(suspect.from, ray.range.x);
    uint steps = 0u;
    // Samples u in [0, 1] of the cell [t, end]: 0, 1/3, 2/3, 1, then the minimum of the cubic through them.
    float a = NO_HIT, fa = 0, b = NO_HIT, fb = 0, last_t = t, last = -1;
    for (int cell = 0; cell < MAX_CELLS && b == NO_HIT; ++cell) {
        PartTruths inside = boxes_at(ray, t + 1e-6);
        float end = cell_end(ray, t, inside);
        vec4 f = vec4(0);
        float low = NO_HIT, far = 0;
        for (int j = 0; j < 5 && b == NO_HIT; ++j) {
            float u = j < 4 ? j / 3.0 : cubic_minimum(f);
            if (u < 0) continue;
            float place = mix(t, end, u);
            // A hair inside the cell: beside a brick the field jumps.
            if (BRICKS == 1) place = clamp(place, t + 1e-6, max(end - 1e-6, t + 1e-6));
            Field here = field_at(at(ray, place), body_at(ray, place), inside);
            ++steps;
            if (j == 0) far = here.bound;
            if (j == 4) {
                // The dip comes before any later sample; its left neighbour is outside.
                if (here.sdf < 0 && f[int(u * 3)] >= 0) {
                    a = mix(t, end, int(u * 3) / 3.0); fa = f[int(u * 3)];
                    b = place; fb = here.sdf;
                }
                continue;
            }
            f[j] = here.sdf;
            if (here.sdf < 0 && last >= 0) { a = last_t; fa = last; b = place; fb = here.sdf; }
            last_t = place;
            last = here.sdf;
            // Nothing can cross within `far` of here.
            if (j == 0 && far > 2 * (end - t)) {
                end = t + min(0.9 * far, max(reach_at(ray, t), 1e-6));
                break;
            }
        }
        t = end;
        if (t > min(suspect.to, ray.range.y)) break;
    }
    if (b != NO_HIT) {
        // False position with a bisection every third time: it cannot stall, not even at a jump of the blend.
        for (int i = 0; i < CLOSE_STEPS && b - a > 1e-7; ++i) {
            float m = i % 3 == 2 ? 0.5 * (a + b) : clamp(a + (b - a) * fa / (fa - fb), a, b);
            float fm = field_at(at(ray, m), body_at(ray, m), boxes_at(ray, m)).sdf;
            ++steps;
            if (fm < 0) { b = m; fb = fm; } else { a = m; fa = fm; }
        }
        ray_t[index] = abs(fb) < abs(fa) ? b : a;
    }
    ray_walked[index] += steps;
}
