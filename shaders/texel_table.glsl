// texel_table.glsl - tables read by index (src/render/texel_table.h): buffer textures where the dialect has them, else
// rows of array textures.
#define ROWS_TEXEL(table, i) texelFetch(table, ivec3(int((i) & 2047u), int(((i) >> 11u) & 2047u), int((i) >> 22u)), 0)
#ifdef TEXEL_BUFFERS
#define UINT_TABLE usamplerBuffer
#define FLOAT_TABLE samplerBuffer
#define TABLE_TEXEL(table, i) texelFetch(table, int(i))
#else
#define UINT_TABLE usampler2DArray
#define FLOAT_TABLE sampler2DArray
#define TABLE_TEXEL(table, i) ROWS_TEXEL(table, i)
#endif
#ifdef TAIL_ROWS
#define TAIL_TABLE usampler2DArray
#define TAIL_TEXEL(table, i) ROWS_TEXEL(table, i)
#else
#define TAIL_TABLE UINT_TABLE
#define TAIL_TEXEL(table, i) TABLE_TEXEL(table, i)
#endif
