// One triangle that covers the whole raster. Writes v_uv: (0, 0) at the corner of texel (0, 0).

out vec2 v_uv;

void main() {
    v_uv = 2.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1);
    gl_Position = vec4(2.0 * v_uv - 1.0, 0.0, 1.0);
}
