// Exact geometry of the triangle under a pixel's centre: unit smooth normal (root frame) and camera z (m).
in vec3 v_normal;
in float v_depth;

layout(location = 0) out vec4 out_geometry;

void main() {
    out_geometry = vec4(normalize(v_normal), v_depth);
}
