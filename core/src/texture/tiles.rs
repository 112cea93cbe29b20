//! Images beside the memory: cut into tiles, which lie in a temporary file and are read when they are looked up.
//!
//! What a lookup finds does not depend on which tiles happen to be in memory.

use super::bitmap::Texels;
use crate::spectrum::Spectrum;
use std::collections::{HashMap, VecDeque};
use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, PoisonError};

/// Texels along a side of a tile.
const SIDE: usize = 64;

/// Parts of the cache, each with a lock of its own, so that threads seldom wait for each other: two to this power.
const SHARD_BITS: u32 = 6;
const SHARDS: usize = 1 << SHARD_BITS;

/// An image in a [`TileFile`].
#[derive(Clone, Debug)]
pub struct Tiles {
    file: Arc<TileFile>,
    /// Where its first tile begins; the others follow row by row.
    start: u64,
    width: usize,
    height: usize,
    kind: Kind,
    /// The largest channel of any texel.
    brightest: f32,
}

/// What a texel is made of.
#[derive(Clone, Debug)]
enum Kind {
    /// Three numbers.
    Colours,
    /// A number.
    Greys,
    /// Three bytes, with the number that a byte stands for.
    ColourBytes(Box<[f32; 256]>),
    /// A byte, with the number that it stands for.
    GreyBytes(Box<[f32; 256]>),
}

impl Kind {
    /// Bytes of a texel.
    fn bytes(&self) -> usize {
        match self {
            Self::Colours => 12,
            Self::Greys => 4,
            Self::ColourBytes(_) => 3,
            Self::GreyBytes(_) => 1,
        }
    }
}

impl Tiles {
    /// How many texels there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The largest channel of any texel, known since it was stored.
    #[must_use]
    pub fn brightest(&self) -> f32 {
        self.brightest
    }

    /// The texel of an index below [`Self::len`], row by row from the top left. Black where the file cannot be read, which
    /// [`TileFile::take_failure`] tells.
    #[must_use]
    pub fn get(&self, index: usize) -> Spectrum {
        let (row, column) = (index / self.width, index % self.width);
        let number = row / SIDE * self.width.div_ceil(SIDE) + column / SIDE;
        let size = self.kind.bytes();
        let start = self.start + (number * SIDE * SIDE * size) as u64;
        let tile = self.file.tile(start, SIDE * SIDE * size);
        let at = (row % SIDE * SIDE + column % SIDE) * size;
        let texel = &tile[at..at + size];
        let number = |i: usize| f32::from_le_bytes([texel[i], texel[i + 1], texel[i + 2], texel[i + 3]]);
        match &self.kind {
            Kind::Colours => Spectrum::from_rgb([number(0), number(4), number(8)]),
            Kind::Greys => Spectrum::splat(number(0)),
            Kind::ColourBytes(values) => {
                Spectrum::from_rgb([texel[0], texel[1], texel[2]].map(|byte| values[usize::from(byte)]))
            }
            Kind::GreyBytes(values) => Spectrum::splat(values[usize::from(texel[0])]),
        }
    }
}

/// A temporary file of tiles, which is gone with the process, and those of them that are in memory.
pub struct TileFile {
    file: Mutex<File>,
    shards: Vec<Mutex<Shard>>,
    /// Most bytes that a shard holds.
    shard_bytes: usize,
    failure: Mutex<Option<String>>,
}

/// Tiles in memory, by where they begin in the file. A tile goes when it has not been looked up since it was last considered, the oldest
/// first (Corbato 1969, "A paging experiment with the Multics system").
#[derive(Default)]
struct Shard {
    tiles: HashMap<u64, (Arc<[u8]>, bool)>,
    order: VecDeque<u64>,
    held: usize,
}

impl fmt::Debug for TileFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TileFile").finish_non_exhaustive()
    }
}

/// The content of a lock; a panic while it was held leaves nothing half done here.
fn locked<T>(lock: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

impl TileFile {
    /// An empty file in the system's folder of temporary files, of whose tiles about `cache_bytes` are kept in memory.
    ///
    /// # Errors
    /// What the system says.
    pub fn new(cache_bytes: usize) -> io::Result<Self> {
        Ok(Self {
            file: Mutex::new(tempfile::tempfile()?),
            shards: (0..SHARDS).map(|_| Mutex::default()).collect(),
            shard_bytes: cache_bytes / SHARDS,
            failure: Mutex::default(),
        })
    }

    /// Writes an image, `width` texels wide, behind all others.
    ///
    /// # Errors
    /// What the system says, such as that the disk is full.
    pub fn store(self: &Arc<Self>, width: usize, texels: &Texels) -> io::Result<Tiles> {
        let kind = match texels {
            Texels::Colours(_) => Kind::Colours,
            Texels::Greys(_) => Kind::Greys,
            Texels::ColourBytes(_, values) => Kind::ColourBytes(values.clone()),
            Texels::GreyBytes(_, values) => Kind::GreyBytes(values.clone()),
            Texels::Tiled(tiles) => return Ok(tiles.clone()),
        };
        let height = texels.len() / width;
        let mut file = locked(&self.file);
        let start = file.seek(SeekFrom::End(0))?;
        let size = kind.bytes();
        let mut tile = vec![0; SIDE * SIDE * size];
        for top in (0..height).step_by(SIDE) {
            for left in (0..width).step_by(SIDE) {
                for (row, line) in tile.chunks_exact_mut(SIDE * size).enumerate().take(height - top) {
                    let first = (top + row) * width + left;
                    for (index, texel) in (first..).zip(line.chunks_exact_mut(size)).take(SIDE.min(width - left)) {
                        write_texel(texels, index, texel);
                    }
                }
                file.write_all(&tile)?;
            }
        }
        drop(file);
        Ok(Tiles {
            file: Arc::clone(self),
            start,
            width,
            height,
            kind,
            brightest: texels.brightest(),
        })
    }

    /// Why a tile could not be read, if one could not since this was last asked. What has been looked up since then is worth nothing.
    #[must_use]
    pub fn take_failure(&self) -> Option<String> {
        locked(&self.failure).take()
    }

    fn tile(&self, start: u64, bytes: usize) -> Arc<[u8]> {
        // Fibonacci hashing (Knuth 1998, The Art of Computer Programming, volume 3, section 6.4).
        let hash = start.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (u64::BITS - SHARD_BITS);
        let shard = &self.shards[hash as usize];
        if let Some((tile, used)) = locked(shard).tiles.get_mut(&start) {
            *used = true;
            return Arc::clone(tile);
        }
        let tile: Arc<[u8]> = match self.read(start, bytes) {
            Ok(tile) => tile.into(),
            Err(error) => {
                locked(&self.failure).get_or_insert_with(|| error.to_string());
                return vec![0; bytes].into();
            }
        };
        locked(shard).insert(start, &tile, self.shard_bytes);
        tile
    }

    fn read(&self, start: u64, bytes: usize) -> io::Result<Vec<u8>> {
        let mut tile = vec![0; bytes];
        let mut file = locked(&self.file);
        file.seek(SeekFrom::Start(start))?;
        file.read_exact(&mut tile)?;
        Ok(tile)
    }
}

impl Shard {
    fn insert(&mut self, start: u64, tile: &Arc<[u8]>, most: usize) {
        if self.tiles.insert(start, (Arc::clone(tile), false)).is_some() {
            return;
        }
        self.order.push_back(start);
        self.held += tile.len();
        while self.held > most.max(tile.len()) {
            let Some(oldest) = self.order.pop_front() else { return };
            match self.tiles.get_mut(&oldest) {
                Some((_, used @ true)) => {
                    *used = false;
                    self.order.push_back(oldest);
                }
                Some((tile, false)) => {
                    self.held -= tile.len();
                    self.tiles.remove(&oldest);
                }
                None => {}
            }
        }
    }
}

fn write_texel(texels: &Texels, index: usize, bytes: &mut [u8]) {
    match texels {
        Texels::Colours(_) | Texels::Greys(_) | Texels::Tiled(_) => {
            let channels = texels.get(index).to_rgb();
            for (bytes, channel) in bytes.chunks_exact_mut(4).zip(channels) {
                bytes.copy_from_slice(&channel.to_le_bytes());
            }
        }
        Texels::ColourBytes(texels, _) => bytes.copy_from_slice(&texels[index]),
        Texels::GreyBytes(texels, _) => bytes[0] = texels[index],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{PathRandom, Stream};

    /// Images of every kind, 150 by 70: parts of tiles at two sides.
    fn images() -> Vec<Texels> {
        let count = 150 * 70;
        let mut random = PathRandom::new(1, 1, Stream::Camera, 0);
        let values: Box<[f32; 256]> = Box::new(std::array::from_fn(|i| (i as f32).sqrt()));
        let mut byte = || (256.0 * random.next_1d()) as u8;
        let colour_bytes = (0..count).map(|_| [byte(), byte(), byte()]).collect();
        let grey_bytes = (0..count).map(|_| byte()).collect();
        let mut number = || random.next_1d();
        vec![
            Texels::Colours(
                (0..count)
                    .map(|_| Spectrum::from_rgb([number(), number(), number()]))
                    .collect(),
            ),
            Texels::Greys((0..count).map(|i| i as f32).collect()),
            Texels::ColourBytes(colour_bytes, values.clone()),
            Texels::GreyBytes(grey_bytes, values),
        ]
    }

    #[test]
    fn tiles_hold_what_was_stored_however_few_fit_into_memory() {
        for cache_bytes in [0, 1 << 20] {
            let file = Arc::new(TileFile::new(cache_bytes).unwrap());
            let images = images();
            let stored: Vec<Tiles> = images.iter().map(|image| file.store(150, image).unwrap()).collect();
            std::thread::scope(|scope| {
                for thread in 0..4 {
                    let (images, stored) = (&images, &stored);
                    scope.spawn(move || {
                        for (image, tiles) in images.iter().zip(stored) {
                            assert_eq!(tiles.brightest(), image.brightest());
                            for index in (0..image.len()).skip(thread).step_by(7) {
                                assert_eq!(tiles.get(index), image.get(index), "texel {index}");
                            }
                        }
                    });
                }
            });
            assert_eq!(file.take_failure(), None);
            let held: usize = file.shards.iter().map(|shard| locked(shard).held).sum();
            assert!(
                held <= cache_bytes.max(SHARDS * SIDE * SIDE * 12),
                "{held} bytes are held"
            );
        }
    }

    #[test]
    fn a_file_that_cannot_be_read_is_told() {
        let file = Arc::new(TileFile::new(0).unwrap());
        let tiles = file.store(150, &images()[1]).unwrap();
        assert_eq!(tiles.get(10), Spectrum::splat(10.0));
        locked(&file.file).set_len(100).unwrap();
        assert_eq!(tiles.get(150 * 69), Spectrum::ZERO);
        assert!(file.take_failure().is_some_and(|failure| !failure.is_empty()));
        assert_eq!(file.take_failure(), None);
    }
}
