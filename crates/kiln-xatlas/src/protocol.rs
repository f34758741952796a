//! Request and reply, byte by byte. All numbers are little-endian; arrays stand one after another without padding; a
//! message ends with its last array.
//!
//! ```text
//! request: "KXRQ", version u32, size u32, padding u32, point count u32, face count u32, density f32,
//!          positions [points] x 3 f32, triangles [faces] x 3 u32, groups [faces] u32
//! reply:   "KXRP", version u32, kind u32
//!     kind 0, charts placed: face count u32, charts [faces] u32, corners [faces] x 3 x 2 f32
//!     kind 1, does not fit:  chart count u32
//!     kind 2, refused:       length u32, UTF-8 text
//! ```
//!
//! Both sides read as if the other were hostile: counts are compared with the bytes that are there before anything is
//! allocated, indices and numbers are checked, nothing is left over.

/// Version of this page. Worker and kiln must agree on it.
pub const VERSION: u32 = 2;

/// Chart of a face that has none.
pub const UNPLACED: u32 = u32::MAX;

/// Longest text of a refusal, bytes.
const TEXT_MAX: usize = 4096;

/// Why bytes are no message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProtocolError {
    /// They begin with something else.
    #[error("not a {0} of kiln-xatlas")]
    WrongMagic(&'static str),
    /// Another version wrote them.
    #[error(
        "kiln-xatlas protocol version {found}, expected {VERSION}: build kiln and kiln-xatlas from the same sources"
    )]
    WrongVersion {
        /// What they say.
        found: u32,
    },
    /// They end too early or too late.
    #[error("message of {found} bytes, expected {expected}")]
    Length {
        /// Bytes that the counts ask for.
        expected: u64,
        /// Bytes there are.
        found: u64,
    },
    /// A value makes no sense.
    #[error("{0}")]
    Value(String),
}

/// What the worker is asked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Request {
    /// Width and height of the sheet, texels.
    pub size: u32,
    /// Least empty space between charts, texels.
    pub padding: u32,
    /// Texels per length of the surface, or 0 for as many as fit the sheet.
    pub density: f32,
    /// `[point_count]`, the surface scaled to a bounding box of unit diagonal.
    pub positions: Vec<[f32; 3]>,
    /// `[face_count] x 3` indices into `positions`.
    pub triangles: Vec<[u32; 3]>,
    /// `[face_count]`: faces of different groups never share a chart.
    pub groups: Vec<u32>,
}

/// What it answers.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// Charts, placed on one sheet.
    Placed {
        /// `[face_count]`, the chart of each face, or [`UNPLACED`].
        charts: Vec<u32>,
        /// `[face_count] x 3`, texels in the sheet.
        corners: Vec<[[f32; 2]; 3]>,
    },
    /// The charts do not fit one sheet at any useful density.
    DoesNotFit {
        /// How many they are.
        charts: u32,
    },
    /// xatlas would not take the mesh.
    Refused(String),
}

impl Request {
    const MAGIC: [u8; 4] = *b"KXRQ";

    /// The request as bytes. `groups` has one entry a face.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Self::MAGIC.to_vec();
        let counts = [self.positions.len() as u32, self.triangles.len() as u32];
        put(&mut bytes, [VERSION, self.size, self.padding].into_iter().chain(counts));
        put(&mut bytes, [self.density.to_bits()]);
        put(&mut bytes, self.positions.as_flattened().iter().map(|c| c.to_bits()));
        put(&mut bytes, self.triangles.as_flattened().iter().copied());
        put(&mut bytes, self.groups.iter().copied());
        bytes
    }

    /// The request out of bytes: finite positions, indices in range.
    ///
    /// # Errors
    /// The bytes are no such request.
    pub fn decode(bytes: &[u8]) -> Result<Request, ProtocolError> {
        let mut words = Words::open(bytes, Self::MAGIC, "request")?;
        let [size, padding, points, faces] = words.take()?;
        let [density] = words.floats()?;
        if density < 0.0 {
            return Err(ProtocolError::Value(format!("a density of {density}")));
        }
        words.expect(3 * u64::from(points) + 4 * u64::from(faces))?;
        let positions: Vec<[f32; 3]> = (0..points).map(|_| words.floats()).collect::<Result<_, _>>()?;
        let triangles: Vec<[u32; 3]> = (0..faces).map(|_| words.take()).collect::<Result<_, _>>()?;
        if let Some(index) = triangles.as_flattened().iter().find(|i| **i >= points) {
            return Err(ProtocolError::Value(format!("point {index} of {points}")));
        }
        let groups = (0..faces).map(|_| words.take().map(|[group]| group)).collect::<Result<_, _>>()?;
        Ok(Request { size, padding, density, positions, triangles, groups })
    }
}

impl Reply {
    const MAGIC: [u8; 4] = *b"KXRP";

    /// The reply as bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Self::MAGIC.to_vec();
        match self {
            Reply::Placed { charts, corners } => {
                put(&mut bytes, [VERSION, 0, charts.len() as u32]);
                put(&mut bytes, charts.iter().copied());
                put(&mut bytes, corners.as_flattened().as_flattened().iter().map(|c| c.to_bits()));
            }
            Reply::DoesNotFit { charts } => put(&mut bytes, [VERSION, 1, *charts]),
            Reply::Refused(text) => {
                let text = &text.as_bytes()[..text.floor_char_boundary(TEXT_MAX)];
                put(&mut bytes, [VERSION, 2, text.len() as u32]);
                bytes.extend(text);
            }
        }
        bytes
    }

    /// The reply to a request of `faces` faces out of bytes: numbers are finite, charts are below `faces` or [`UNPLACED`].
    ///
    /// # Errors
    /// The bytes are no such reply.
    pub fn decode(bytes: &[u8], faces: usize) -> Result<Reply, ProtocolError> {
        let mut words = Words::open(bytes, Self::MAGIC, "reply")?;
        match words.take()? {
            [0] => {
                let [found] = words.take()?;
                if found as usize != faces {
                    return Err(ProtocolError::Value(format!("{found} faces came back for {faces}")));
                }
                words.expect(7 * u64::from(found))?;
                let charts: Vec<u32> = (0..faces).map(|_| words.take().map(|[c]| c)).collect::<Result<_, _>>()?;
                if let Some(chart) = charts.iter().find(|c| **c as usize >= faces && **c != UNPLACED) {
                    return Err(ProtocolError::Value(format!("chart {chart} of at most {faces}")));
                }
                let corner = |[a, b, c, d, e, f]: [f32; 6]| [[a, b], [c, d], [e, f]];
                let corners = (0..faces).map(|_| words.floats().map(corner)).collect::<Result<_, _>>()?;
                Ok(Reply::Placed { charts, corners })
            }
            [1] => {
                words.expect(1)?;
                let [charts] = words.take()?;
                Ok(Reply::DoesNotFit { charts })
            }
            [2] => {
                let [length] = words.take()?;
                if length as usize != words.0.len() || length as usize > TEXT_MAX {
                    return Err(ProtocolError::Length { expected: length.into(), found: words.0.len() as u64 });
                }
                Ok(Reply::Refused(String::from_utf8_lossy(words.0).into_owned()))
            }
            [kind] => Err(ProtocolError::Value(format!("reply of unknown kind {kind}"))),
        }
    }
}

fn put(bytes: &mut Vec<u8>, words: impl IntoIterator<Item = u32>) {
    bytes.extend(words.into_iter().flat_map(u32::to_le_bytes));
}

/// Reads 32-bit words off the front.
struct Words<'a>(&'a [u8]);

impl<'a> Words<'a> {
    fn open(bytes: &'a [u8], magic: [u8; 4], name: &'static str) -> Result<Words<'a>, ProtocolError> {
        let Some(rest) = bytes.strip_prefix(&magic) else { return Err(ProtocolError::WrongMagic(name)) };
        let mut words = Words(rest);
        match words.take()? {
            [VERSION] => Ok(words),
            [found] => Err(ProtocolError::WrongVersion { found }),
        }
    }

    /// Refuses any other number of remaining words.
    fn expect(&self, words: u64) -> Result<(), ProtocolError> {
        let (expected, found) = (4 * words, self.0.len() as u64);
        if expected == found { Ok(()) } else { Err(ProtocolError::Length { expected, found }) }
    }

    fn take<const N: usize>(&mut self) -> Result<[u32; N], ProtocolError> {
        let short = ProtocolError::Length { expected: 4 * N as u64, found: self.0.len() as u64 };
        let (head, tail) = self.0.split_at_checked(4 * N).ok_or(short)?;
        self.0 = tail;
        let (words, _) = head.as_chunks::<4>();
        Ok(std::array::from_fn(|i| u32::from_le_bytes(words[i])))
    }

    fn floats<const N: usize>(&mut self) -> Result<[f32; N], ProtocolError> {
        let values = self.take()?.map(f32::from_bits);
        if values.iter().all(|v| v.is_finite()) {
            Ok(values)
        } else {
            Err(ProtocolError::Value("a number is not finite".into()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> Request {
        Request {
            size: 256,
            padding: 4,
            density: 96.5,
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]],
            triangles: vec![[0, 1, 2], [2, 1, 0]],
            groups: vec![0, 5],
        }
    }

    fn replies() -> [Reply; 3] {
        let corners = vec![[[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]; 2];
        let placed = Reply::Placed { charts: vec![1, UNPLACED], corners };
        [placed, Reply::DoesNotFit { charts: 900 }, Reply::Refused("no faces: né".into())]
    }

    #[test]
    fn messages_come_back_as_they_were_sent() {
        assert_eq!(Request::decode(&request().encode()), Ok(request()));
        for reply in replies() {
            assert_eq!(Reply::decode(&reply.encode(), 2), Ok(reply));
        }
    }

    #[test]
    fn every_prefix_and_every_longer_message_is_refused() {
        let bytes = request().encode();
        for end in 0..bytes.len() {
            assert!(Request::decode(&bytes[..end]).is_err(), "prefix of {end} bytes was taken");
        }
        assert!(Request::decode(&[&bytes[..], &[0]].concat()).is_err());
        for bytes in replies().map(|r| r.encode()) {
            for end in 0..bytes.len() {
                assert!(Reply::decode(&bytes[..end], 2).is_err(), "prefix of {end} bytes was taken");
            }
            assert!(Reply::decode(&[&bytes[..], &[0]].concat(), 2).is_err());
        }
    }

    #[test]
    fn flipped_bytes_never_panic_and_never_pass_a_bad_index_or_number() {
        let bytes = request().encode();
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut bytes = bytes.clone();
                bytes[at] ^= 1 << bit;
                if let Ok(request) = Request::decode(&bytes) {
                    assert!(request.triangles.as_flattened().iter().all(|i| *i < 3));
                    assert!(request.positions.as_flattened().iter().all(|c| c.is_finite()));
                }
            }
        }
        let bytes = replies()[0].encode();
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut bytes = bytes.clone();
                bytes[at] ^= 1 << bit;
                if let Ok(Reply::Placed { charts, corners }) = Reply::decode(&bytes, 2) {
                    assert!(charts.iter().all(|c| *c < 2 || *c == UNPLACED));
                    assert!(corners.as_flattened().as_flattened().iter().all(|c| c.is_finite()));
                }
            }
        }
    }

    #[test]
    fn counts_that_promise_more_than_there_is_are_refused_before_anything_is_allocated() {
        let mut bytes = request().encode();
        bytes[16..24].fill(0xFF);
        assert!(matches!(Request::decode(&bytes), Err(ProtocolError::Length { .. })));
    }

    #[test]
    fn another_version_is_refused_with_its_number() {
        let mut bytes = request().encode();
        bytes[4] = 9;
        assert_eq!(Request::decode(&bytes), Err(ProtocolError::WrongVersion { found: 9 }));
    }

    #[test]
    fn a_long_refusal_is_cut_at_a_character() {
        let long = Reply::Refused("é".repeat(3000)).encode();
        let Ok(Reply::Refused(text)) = Reply::decode(&long, 0) else { panic!("not a refusal") };
        assert_eq!(text, "é".repeat(2048));
    }
}
