// Writes what the face networks see: albedo (sRGB) and mask, unit normal (head frame).
in vec3 v_albedo;
in vec3 v_normal;

layout(location = 0) out vec4 out_albedo_mask;
layout(location = 1) out vec4 out_normal;

void main() {
    out_albedo_mask = vec4(v_albedo, 1);
    out_normal = vec4(dot(v_normal, v_normal) > 0 ? normalize(v_normal) : vec3(0), 0);
}
