meta:
  id: kiln
  title: kiln container, version 1
  file-extension: kiln
  license: MIT
  ks-version: "0.10"
  endian: le
  encoding: UTF-8
doc: |
  Levels of detail of one asset: geometry, materials, textures, and layouts of continuous detail. `container-v1.md` beside this file is
  the specification; the sections are named after its chapters. Hashes, paddings and most rules between tables are not checked here.

  Tables are parsed where `table.<kind>` is asked for, payload where a level's arrays, a mip or a layout is. Sections in a codec other
  than 0 are given as stored bytes.
doc-ref: container-v1.md
seq:
  - id: header
    type: header
  - id: sections
    type: section
    repeat: expr
    repeat-expr: header.section_count
instances:
  tables:
    type: tables
    doc: Every table once; optional ones where they are there.
types:
  header:
    doc: Chapter 2.1.
    seq:
      - id: magic
        contents: [0x89, KLN, 0x0d, 0x0a, 0x1a, 0x0a]
      - id: endian_marker
        contents: [4, 3, 2, 1]
      - id: major
        type: u2
        valid: 1
      - id: minor
        type: u2
      - id: file_length
        type: u8
        valid: _io.size
      - id: table_offset
        type: u8
        valid: 96
      - id: section_count
        type: u4
        valid:
          max: 1048576
      - id: reserved
        size: 28
      - id: hash
        size: 32
        doc: BLAKE3 of bytes 0 to 63 and the section table.

  section:
    doc: Chapter 2.2.
    seq:
      - id: kind
        type: str
        size: 4
        encoding: ASCII
      - id: version
        type: u2
      - id: flags
        type: u2
      - id: codec
        type: u4
        enum: codec
      - id: alignment
        type: u4
      - id: offset
        type: u8
      - id: stored_length
        type: u8
      - id: raw_length
        type: u8
      - id: reserved0
        size: 8
      - id: stored_hash
        size: 32
      - id: raw_hash
        size: 32
      - id: reserved1
        size: 16
    instances:
      is_required:
        value: (flags & 1) == 1
      stored:
        io: _root._io
        pos: offset
        size: stored_length
        doc: The bytes in the file.
      body:
        io: _root._io
        pos: offset
        size: stored_length
        if: codec == codec::none
        type:
          switch-on: kind
          cases:
            '"STRS"': strings
            '"LEVL"': levels
            '"SUBM"': submeshes
            '"MATL"': materials
            '"TEXT"': textures
            '"PROV"': provenance
            '"WNDW"': window
            '"TREE"': tree
            '"LEAF"': leaf
            '"CTRE"': compact_tree
            '"CLUS"': clusters
        doc: |
          What the section holds, by kind; bytes for others (VERT and INDX, which a level's arrays describe, MIPT and MIPL, which mip
          records do, private sections).
    enums:
      codec:
        0: none
        1: zstd
        2: lz4
        3: meshopt_vertex
        4: meshopt_index
        5: meshopt_index_zstd

  tables:
    doc: The tables, which stand first and in this order.
    instances:
      strings:
        value: _root.sections[0].body.as<strings>
      levels:
        value: _root.sections[1].body.as<levels>
      submeshes:
        value: _root.sections[2].body.as<submeshes>
      materials:
        value: _root.sections[3].body.as<materials>
      textures:
        value: _root.sections[4].body.as<textures>
      has_provenance:
        value: _root.sections.size > 5 and _root.sections[5].kind == "PROV"
      provenance:
        value: _root.sections[5].body.as<provenance>
        if: has_provenance

  string:
    doc: Chapter 1; NFC.
    seq:
      - id: length
        type: u4
        valid:
          max: 65535
      - id: text
        type: str
        size: length
      - id: padding
        size: (4 - length % 4) % 4

  string_reference:
    seq:
      - id: number
        type: u4
    instances:
      text:
        value: _root.tables.strings.strings[number].text

  vec2:
    seq:
      - id: x
        type: f4
      - id: y
        type: f4
  vec3:
    seq:
      - id: x
        type: f4
      - id: y
        type: f4
      - id: z
        type: f4
  vec4:
    seq:
      - id: x
        type: f4
      - id: y
        type: f4
      - id: z
        type: f4
      - id: w
        type: f4

  strings:
    doc: STRS, chapter 3.1.
    seq:
      - id: count
        type: u4
        valid:
          max: 4194304
      - id: reserved
        size: 12
      - id: strings
        type: string
        repeat: expr
        repeat-expr: count

  levels:
    doc: LEVL, chapter 3.2.
    seq:
      - id: level_count
        type: u4
        valid:
          min: 1
          max: 256
      - id: array_count
        type: u4
      - id: need_count
        type: u4
      - id: source_triangles
        type: u4
      - id: has_layout
        type: u4
      - id: layout_size
        type: u4
      - id: layout_padding
        type: u4
      - id: layout_charts
        type: u4
      - id: levels
        type: level
        repeat: expr
        repeat-expr: level_count
      - id: arrays
        type: array
        repeat: expr
        repeat-expr: array_count
      - id: needs
        type: u4
        repeat: expr
        repeat-expr: need_count

  level:
    seq:
      - id: triangles
        type: u4
      - id: vertices
        type: u4
      - id: error
        type: f4
      - id: error_kind
        type: u4
        enum: error_kind
      - id: bounds_min
        type: vec3
      - id: bounds_max
        type: vec3
      - id: vertex_section
        type: u4
      - id: index_section
        type: u4
      - id: index_width
        type: u4
      - id: first_array
        type: u4
      - id: array_count
        type: u4
      - id: first_need
        type: u4
      - id: need_count
        type: u4
      - id: layout_sheets
        type: u4
      - id: reserved
        size: 24
    instances:
      arrays:
        type: level_array(first_array + _index, vertex_section)
        repeat: expr
        repeat-expr: array_count
      indices:
        io: _root._io
        pos: _root.sections[index_section].offset
        size: 3 * triangles * index_width
        if: _root.sections[index_section].codec == section::codec::none
        doc: 16- or 32-bit, by index_width.
    enums:
      error_kind:
        1: sampled
        2: bound

  level_array:
    doc: An array record of a level together with its bytes.
    params:
      - id: number
        type: u4
      - id: vertex_section
        type: u4
    instances:
      record:
        value: _root.tables.levels.arrays[number]
      values:
        io: _root._io
        pos: _root.sections[vertex_section].offset + record.offset
        size: record.length
        if: _root.sections[vertex_section].codec == section::codec::none

  array:
    seq:
      - id: semantic
        type: u4
        enum: semantic
      - id: format
        type: u4
        enum: vertex_format
      - id: offset
        type: u8
      - id: length
        type: u8
      - id: reserved
        size: 8
    enums:
      semantic:
        1: positions
        2: normals
        3: tangents
        4: uv0
        5: uv1
        6: colors
        7: joints
        8: weights
      vertex_format:
        1: f32x2
        2: f32x3
        3: f32x4
        4: u16x4

  submeshes:
    doc: SUBM, chapter 3.3.
    seq:
      - id: submesh_count
        type: u4
        valid:
          max: 1048576
      - id: level_count
        type: u4
      - id: reserved
        size: 8
      - id: submeshes
        type: submesh
        repeat: expr
        repeat-expr: submesh_count
      - id: ranges
        type: draw_range
        repeat: expr
        repeat-expr: submesh_count * level_count
        doc: Level by level.

  submesh:
    seq:
      - id: name
        type: string_reference
      - id: material
        type: u4
        doc: 0xffffffff for none.
      - id: attributes
        type: u4
      - id: source_triangles
        type: u4
      - id: reserved
        size: 16
    instances:
      has_material:
        value: material != 0xffffffff

  draw_range:
    seq:
      - id: first_index
        type: u4
      - id: index_count
        type: u4
      - id: first_vertex
        type: u4
      - id: vertex_count
        type: u4
      - id: bounds_min
        type: vec3
      - id: bounds_max
        type: vec3
      - id: reserved
        size: 8

  materials:
    doc: MATL, chapter 3.4.
    seq:
      - id: count
        type: u4
        valid:
          max: 65536
      - id: reserved
        size: 12
      - id: materials
        type: material
        repeat: expr
        repeat-expr: count

  material:
    seq:
      - id: name
        type: string_reference
      - id: alpha_mode
        type: u4
        enum: alpha_mode
      - id: alpha_cutoff
        type: f4
      - id: flags
        type: u4
      - id: base_color_factor
        type: vec4
      - id: emissive_factor
        type: vec3
      - id: metallic_factor
        type: f4
      - id: roughness_factor
        type: f4
      - id: normal_scale
        type: f4
      - id: occlusion_strength
        type: f4
      - id: reserved
        size: 4
      - id: slots
        type: slot
        repeat: expr
        repeat-expr: 5
        doc: Base colour, metallic-roughness, normal, occlusion, emissive.
    instances:
      is_double_sided:
        value: (flags & 1) == 1
    enums:
      alpha_mode:
        0: opaque
        1: mask
        2: blend

  slot:
    seq:
      - id: texture
        type: u4
        doc: 0xffffffff for none.
      - id: uv_set
        type: u4
      - id: wrap_u
        type: u1
        enum: wrap
      - id: wrap_v
        type: u1
        enum: wrap
      - id: mag
        type: u1
      - id: min
        type: u1
      - id: mip
        type: u1
      - id: reserved0
        size: 3
      - id: uv_offset
        type: vec2
      - id: uv_scale
        type: vec2
      - id: uv_rotation
        type: f4
      - id: reserved1
        size: 12
    instances:
      is_used:
        value: texture != 0xffffffff
    enums:
      wrap:
        0: repeat
        1: mirrored_repeat
        2: clamp_to_edge

  textures:
    doc: TEXT, chapter 3.5.
    seq:
      - id: texture_count
        type: u4
        valid:
          max: 65536
      - id: mip_count
        type: u4
      - id: reserved
        size: 8
      - id: textures
        type: texture
        repeat: expr
        repeat-expr: texture_count
      - id: mips
        type: mip
        repeat: expr
        repeat-expr: mip_count

  texture:
    seq:
      - id: name
        type: string_reference
      - id: format
        type: u4
        enum: texture_format
      - id: roles
        type: u4
        doc: Bits 0 to 4 are slots of materials, bits 5 to 14 extras.
      - id: channels
        type: u1
        enum: channel
        repeat: expr
        repeat-expr: 4
      - id: width
        type: u4
      - id: height
        type: u4
      - id: mip_count
        type: u4
      - id: first_mip
        type: u4
      - id: tail_first
        type: u4
      - id: tail_section
        type: u4
      - id: sheet
        type: u4
      - id: reserved
        size: 20
    instances:
      mips:
        type: texture_mip(first_mip + _index)
        repeat: expr
        repeat-expr: mip_count
    enums:
      texture_format:
        1: rgba8_unorm
        2: rgba8_srgb
        3: rgba16_unorm
        4: rgba16_float
        5: rgba32_float
        6: bc5_unorm
        7: bc7_unorm
        8: bc7_srgb
      channel:
        0: unused
        1: red
        2: green
        3: blue
        4: alpha
        5: normal_x
        6: normal_y
        7: normal_z
        8: roughness
        9: metallic
        10: occlusion
        11: height
        12: position_x
        13: position_y
        14: position_z
        15: object_normal_x
        16: object_normal_y
        17: object_normal_z
        18: object_id
        19: material_id
        20: curvature
        21: bent_normal_x
        22: bent_normal_y
        23: bent_normal_z
        24: opacity
        25: coverage

  texture_mip:
    doc: A mip record of a texture together with its bytes.
    params:
      - id: number
        type: u4
    instances:
      record:
        value: _root.tables.textures.mips[number]
      texels:
        io: _root._io
        pos: _root.sections[record.section].offset + record.offset
        size: record.length
        if: _root.sections[record.section].codec == section::codec::none

  mip:
    seq:
      - id: width
        type: u4
      - id: height
        type: u4
      - id: section
        type: u4
      - id: reserved
        size: 4
      - id: offset
        type: u8
      - id: length
        type: u8

  provenance:
    doc: PROV, chapter 3.6.
    seq:
      - id: pipeline
        size: 32
      - id: input_count
        type: u4
      - id: stage_count
        type: u4
      - id: reserved
        size: 24
      - id: tool
        type: string
      - id: numeric_class
        type: string
      - id: device_class
        type: string
      - id: inputs
        type: provenance_input
        repeat: expr
        repeat-expr: input_count
      - id: stages
        type: provenance_stage
        repeat: expr
        repeat-expr: stage_count
  provenance_input:
    seq:
      - id: hash
        size: 32
      - id: name
        type: string
  provenance_stage:
    seq:
      - id: name
        type: string
      - id: version
        type: string

  checkpoint:
    doc: Chapter 5; 32 bytes.
    seq:
      - id: detail
        type: u4
      - id: vertices
        type: u4
      - id: triangles
        type: u4
      - id: error
        type: f4
      - id: level
        type: u4
        doc: 0xffffffff for none.
      - id: reserved
        size: 12
    instances:
      has_level:
        value: level != 0xffffffff

  window:
    doc: WNDW, chapter 5.1.
    seq:
      - id: vertices
        type: u4
      - id: triangles
        type: u4
      - id: collapses
        type: u4
      - id: base_vertices
        type: u4
      - id: checkpoint_count
        type: u4
      - id: flags
        type: u4
      - id: reserved
        size: 40
      - id: checkpoints
        type: checkpoint
        repeat: expr
        repeat-expr: checkpoint_count
    instances:
      has_starts:
        value: (flags & 1) == 1
      parents_offset:
        value: (64 + 32 * checkpoint_count + 255) / 256 * 256
      starts_offset:
        value: (parents_offset + 4 * vertices + 255) / 256 * 256
      parents:
        pos: parents_offset
        type: u4
        repeat: expr
        repeat-expr: vertices
      starts:
        pos: starts_offset
        type: u4
        repeat: expr
        repeat-expr: (vertices + 31) / 32
        if: has_starts
        doc: Bit v % 32 of word v / 32 says that vertex v is the first of its point.

  tree_header:
    doc: The start of TREE and CTRE.
    seq:
      - id: nodes
        type: u4
      - id: vertices
        type: u4
      - id: rows
        type: u4
        valid:
          max: 64
      - id: columns
        type: u4
      - id: width
        type: u4
        valid:
          max: 8192
      - id: checkpoint_count
        type: u4
      - id: reserved
        size: 40
      - id: checkpoints
        type: checkpoint
        repeat: expr
        repeat-expr: checkpoint_count
      - id: row_starts
        type: u4
        repeat: expr
        repeat-expr: rows + 1
    instances:
      face_counts_offset:
        value: (64 + 32 * checkpoint_count + 4 * (rows + 1) + 255) / 256 * 256
      behind_face_counts:
        value: (face_counts_offset + 4 * (nodes + 1) + 255) / 256 * 256
      face_counts:
        pos: face_counts_offset
        type: u4
        repeat: expr
        repeat-expr: nodes + 1
      last_face_count:
        pos: face_counts_offset + 4 * nodes
        type: u4

  tree:
    doc: TREE, chapter 5.2.
    seq:
      - id: header
        type: tree_header
    instances:
      texels:
        pos: header.behind_face_counts
        type: vec4
        repeat: expr
        repeat-expr: header.width * header.rows * ((header.columns + header.width - 1) / header.width)
        doc: x, y, z, q.

  leaf:
    doc: LEAF, chapter 5.2.
    instances:
      leaves:
        pos: 0
        type: vec4
        repeat: eos
        doc: x, y, z, number of the terminal node's texel.

  compact_tree:
    doc: CTRE, chapter 5.3.
    seq:
      - id: header
        type: tree_header
    instances:
      terminals_offset:
        value: (header.behind_face_counts + 16 * header.nodes + 255) / 256 * 256
      nodes:
        pos: header.behind_face_counts
        type: compact_node
        repeat: expr
        repeat-expr: header.nodes
      terminals:
        pos: terminals_offset
        type: u4
        repeat: expr
        repeat-expr: header.vertices
  compact_node:
    seq:
      - id: position
        type: vec3
      - id: parent
        type: u4

  clusters:
    doc: CLUS, chapter 5.4.
    seq:
      - id: cluster_count
        type: u4
      - id: group_count
        type: u4
      - id: levels
        type: u4
      - id: reference_count
        type: u4
      - id: triangles
        type: u4
      - id: vertices
        type: u4
      - id: reserved
        size: 40
    instances:
      groups_offset:
        value: (256 + 64 * cluster_count + 255) / 256 * 256
      references_offset:
        value: (groups_offset + 32 * group_count + 255) / 256 * 256
      corners_offset:
        value: (references_offset + 4 * reference_count + 255) / 256 * 256
      clusters:
        pos: 256
        type: cluster
        repeat: expr
        repeat-expr: cluster_count
      groups:
        pos: groups_offset
        type: group
        repeat: expr
        repeat-expr: group_count
      references:
        pos: references_offset
        type: u4
        repeat: expr
        repeat-expr: reference_count
      corners:
        pos: corners_offset
        size: 3 * triangles
  cluster:
    seq:
      - id: first_reference
        type: u4
      - id: vertex_count
        type: u4
      - id: first_triangle
        type: u4
      - id: triangle_count
        type: u4
      - id: submesh
        type: u4
      - id: group
        type: u4
      - id: made_by
        type: u4
        doc: 0xffffffff for none.
      - id: level
        type: u4
      - id: sphere
        type: vec4
      - id: cone
        type: vec4
  group:
    seq:
      - id: sphere
        type: vec4
      - id: error
        type: f4
      - id: first_cluster
        type: u4
      - id: cluster_count
        type: u4
      - id: level
        type: u4
