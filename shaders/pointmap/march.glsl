// Sphere tracing to the first outside-to-inside crossing, with a smallest step; then the bracket is closed.
const float FINEST = 0.25;      // smallest step, in voxels of the box or grid the ray is in
const int MAX_STEPS = 400;      // 128 voxels x sqrt 3 x the inverse of an average step of half a voxel
const int SECANTS = 3;
const float SLOPE = 2;          // of an interpolated field, at most: 1 for a distance, a little more for a learned one
const float CONVERGED = 2e-6;   // metres: residual above which the exact walk takes over

struct Hit {
    float t;       // NO_HIT where there is none
    vec2 suspect;  // t from and to which the exact walk must check the ray; NO_HIT where it need not
    float near;    // t up to which the whole pixel is free
    float far;     // t from which it is again, where there is no hit
    bool grazes;   // misses the surface by less than half a pixel's diagonal
    uint steps;
};

Field field_on(Ray ray, float t) { return field_at(at(ray, t), body_at(ray, t), boxes_at(ray, t)); }

// From `start` to `end`. `close`: whether t is wanted, and not only whether there is a hit.
Hit march(Ray ray, float start, float end, bool close) {
    Hit hit = Hit(NO_HIT, vec2(NO_HIT), NO_HIT, NOWHERE, false, 0u);
    end = min(end, ray.range.y);
    float t = max(ray.range.x, start), s = -1, before = t, earlier = t, s_before = -1, smallest = 0;
    bool found = false, tight = true;
    if (t > end) return hit;
    for (int i = 0; i < MAX_STEPS; ++i) {
        PartTruths inside = boxes_at(ray, t);
        Field f = field_filtered(at(ray, t), body_at(ray, t), inside);
        ++hit.steps;
        s = f.sdf;
        if (i == 0 && s < 0 && t > ray.range.x) {  // whoever said that the way is free up to here was wrong
            t = ray.range.x;
            before = t;
            earlier = t;
            continue;
        }
        float pixel = ray.footprint * (1 - t / ray.camera);
        // Spheres of two footprints that touch leave a tube of one footprint free.
        if (f.bound < 2 * pixel) hit.near = min(hit.near, t);
        if (i == 0 || tight) hit.far = t;
        tight = f.bound < max(2 * pixel, FINEST * f.voxel);
        if (s < 0 && s_before >= 0) { found = true; break; }
        hit.grazes = hit.grazes || (s >= 0 && s < 1.1 * pixel);
        // A dip between two samples: only where the smallest step was longer than the distance, and the field rises
        // again. Fields are steeper than 1 by no more than SLOPE.
        bool dip = s_before >= 0 && s_before < smallest && s >= s_before && s + s_before < SLOPE * smallest;
        if (dip) hit.suspect = vec2(min(hit.suspect.x, earlier), t);
        if (t >= end) break;
        smallest = FINEST * f.voxel;
        earlier = before;
        before = t;
        s_before = s;
        float reach = PARTS != 0 ? max(reach_at(ray, t), 1e-6) : NOWHERE;
        t = min(t + min(max(f.bound, smallest), reach), end);
    }
    if (tight) hit.far = NOWHERE;
    if (!found) return hit;
    hit.far = NOWHERE;
    hit.near = min(hit.near, before);
    float a = before, b = t, fa = s_before, fb = s, fm = 0;
    // `found` in the condition: where SIMD runs both sides of an `if`, it still leaves a loop that nobody is in.
    for (int i = 0; i < SECANTS && found && close; ++i) {
        float m = clamp(a + (b - a) * fa / (fa - fb), a, b);
        fm = field_on(ray, m).sdf;
        if (fm < 0) { b = m; fb = fm; } else { a = m; fa = fm; }
    }
    if (close) hit.steps += uint(SECANTS);
    hit.t = clamp(a + (b - a) * fa / max(fa - fb, 1e-12), a, b);
    if (abs(fm) > CONVERGED) hit.suspect.x = min(hit.suspect.x, before);
    hit.suspect.y = t;
    return hit;
}
