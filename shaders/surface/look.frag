// What a view mode shows instead of colour, as surface/look.py has it: normals, depth, parts, or colours of its own.
in vec3 v_position;  // root frame, metres
in vec3 v_normal;    // root frame, not unit
in vec3 v_part;      // share of each part
in vec3 v_own;       // sRGB-encoded

uniform int u_look;         // 0 normals, 1 depth, 2 parts, 3 own
uniform vec4 u_depth;       // camera z of a point (p, 1), metres
uniform vec2 u_range;       // nearest and farthest depth, metres
uniform vec3 u_parts[4];    // the body's colour, then that of each part

layout(location = 0) out vec4 out_colour;

void main() {
    vec3 colour = 0.5 + 0.5 * normalize(v_normal);
    if (u_look == 1) {
        colour = vec3(1.0 - DEPTH_FADE * clamp((dot(u_depth, vec4(v_position, 1)) - u_range.x) / (u_range.y - u_range.x), 0.0, 1.0));
    } else if (u_look >= 2) {
        vec3 flat_colour = u_parts[0] * (1.0 - v_part.x - v_part.y - v_part.z);
        flat_colour += u_parts[1] * v_part.x + u_parts[2] * v_part.y + u_parts[3] * v_part.z;
        flat_colour = u_look == 2 ? flat_colour : v_own;
        colour = flat_colour * (0.55 + 0.45 * abs(dot(normalize(v_normal), normalize(u_depth.xyz))));
    }
    out_colour = vec4(colour, 1);
}
