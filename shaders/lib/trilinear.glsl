// Trilinear interpolation. `place` in voxels, 0 at the first voxel's centre; clamped at the border.

// By the texture unit: fast, but hardware rounds the weights to 8 fractional bits (0.08 mm at 2 cm). For steps only.
vec2 trilinear_filtered(sampler3D grid, vec3 place) {
    return textureLod(grid, (place + 0.5) / vec3(textureSize(grid, 0)), 0.0).xy;
}

// By eight texel fetches: exact in float. For everything that is kept.
vec2 trilinear(sampler3D grid, vec3 place) {
    ivec3 last = textureSize(grid, 0) - 1;
    place = clamp(place, vec3(0), vec3(last));
    ivec3 low = ivec3(place), high = min(low + 1, last);
    vec3 t = place - vec3(low);
    vec2 row[4];
    for (int k = 0; k < 4; ++k) {
        int y = (k & 1) == 0 ? low.y : high.y, z = (k & 2) == 0 ? low.z : high.z;
        row[k] = mix(texelFetch(grid, ivec3(low.x, y, z), 0).xy, texelFetch(grid, ivec3(high.x, y, z), 0).xy, t.x);
    }
    return mix(mix(row[0], row[1], t.y), mix(row[2], row[3], t.y), t.z);
}
