// One corner of a triangle of the posed subject, three to a triangle, unindexed: every fragment knows its triangle and
// where in it it lies. Reads faces and vertices; writes clip coordinates with the picture's top as the first row.
layout(std430, binding = 0) readonly buffer Faces { uint in_face[]; };      // 3 per triangle
layout(std430, binding = 1) readonly buffer Vertices { vec4 in_vertex[]; }; // position (m), openness; normal, fold (m)

uniform mat4 u_clip_from_root;

out vec2 v_bary;      // weights of the second and third corner
out vec3 v_normal;    // root frame, not unit
out vec2 v_shade;     // openness, fold height
out float v_depth;    // camera z, metres
flat out uint v_face;

void main() {
    uint corner = uint(gl_VertexID) % 3u;
    uint vertex = in_face[gl_VertexID];
    vec4 place = in_vertex[2u * vertex], bend = in_vertex[2u * vertex + 1u];
    gl_Position = u_clip_from_root * vec4(place.xyz, 1);
    v_bary = vec2(corner == 1u, corner == 2u);
    v_normal = bend.xyz;
    v_shade = vec2(place.w, bend.w);
    v_depth = gl_Position.w;
    v_face = uint(gl_VertexID) / 3u;
}
