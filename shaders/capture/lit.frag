// Colour of the subject under the studio light (capture/synthetic/shade.py), sRGB-encoded, and coverage.
// Albedo comes from a triangular lattice of n + 1 samples a side on every triangle (capture/synthetic/albedo_lattice.py).
layout(std430, binding = 2) readonly buffer Lattices { uvec2 in_lattice[]; };  // first sample, n
layout(std430, binding = 3) readonly buffer Samples { uint in_sample[]; };     // 10 bits each of r, g, b

in vec2 v_bary;
in vec3 v_normal;
in vec2 v_shade;
flat in uint v_face;

uniform vec3 u_key, u_fill, u_rim, u_up, u_warm, u_cool;  // unit directions in the root frame; tints

layout(location = 0) out vec4 out_colour;

vec3 at(uvec2 lattice, uint i, uint j) {
    uint word = in_sample[lattice.x + j * (lattice.y + 1u) - (j * j - j) / 2u + i];
    return vec3(word & 1023u, (word >> 10) & 1023u, word >> 20) / 1023.0;
}

vec3 albedo() {
    uvec2 lattice = in_lattice[v_face];
    float n = float(lattice.y);
    vec2 place = clamp(v_bary, 0.0, 1.0) * n;
    place *= min(1.0, n / max(place.x + place.y, 1e-6));
    uvec2 cell = uvec2(place);
    cell.x = min(cell.x, lattice.y - 1u);
    cell.y = min(cell.y, lattice.y - 1u - cell.x);
    vec2 t = place - vec2(cell);
    vec3 right = at(lattice, cell.x + 1u, cell.y), above = at(lattice, cell.x, cell.y + 1u);
    if (t.x + t.y <= 1.0 || cell.x + cell.y + 2u > lattice.y)
        return (1.0 - t.x - t.y) * at(lattice, cell.x, cell.y) + t.x * right + t.y * above;
    return (t.x + t.y - 1.0) * at(lattice, cell.x + 1u, cell.y + 1u) + (1.0 - t.x) * above + (1.0 - t.y) * right;
}

float soft(vec3 normal, vec3 direction) {
    float lit = clamp((dot(normal, direction) + WRAP) / (1.0 + WRAP), 0.0, 1.0);
    return 0.5 * lit * lit * (3.0 - 2.0 * lit) + 0.5 * lit;
}

void main() {
    vec3 normal = normalize(v_normal);
    float sky = 0.5 + 0.5 * dot(normal, u_up);
    vec3 light = (0.42 + 0.18 * sky) * u_cool + 0.42 * soft(normal, u_key) * u_warm + 0.16 * soft(normal, u_fill) * u_cool;
    light += 0.20 * soft(normal, u_rim) * u_warm;
    float shadow = 0.42 + 0.58 * clamp(v_shade.x, 0.0, 1.0);
    float fold = 1.0 + 0.16 * tanh(v_shade.y / 0.003);
    out_colour = vec4(clamp(albedo() * light * (shadow * fold * 1.06), 0.0, 1.0), 1.0);
}
