// The surface under a pixel's centre: position (root frame, m) and 1 where it is hit; the unit normal; the
// share of each part.
in vec3 v_position;
in vec3 v_normal;
in vec3 v_part;

layout(location = 0) out vec4 out_position;
layout(location = 1) out vec4 out_normal;
layout(location = 2) out vec4 out_part;

void main() {
    out_position = vec4(v_position, 1);
    out_normal = vec4(normalize(v_normal), 0);
    out_part = vec4(v_part, 1);
}
