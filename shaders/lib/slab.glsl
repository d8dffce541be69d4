// Where a ray is inside the box [0, size]: (entry, exit), entry > exit where it misses.
// A component of zero would give 0 * inf on a face: it is replaced by one too small to matter within a kilometre.
vec2 slab(vec3 origin, vec3 direction, vec3 size) {
    vec3 safe = mix(direction, vec3(1e-12), lessThan(abs(direction), vec3(1e-12)));
    vec3 a = -origin / safe, b = (size - origin) / safe;
    vec3 near = min(a, b), far = max(a, b);
    return vec2(max(max(near.x, near.y), near.z), min(min(far.x, far.y), far.z));
}
