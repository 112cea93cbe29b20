//! Pictures in terminals that can show them: by the graphics protocol of kitty, the inline images of iTerm2, or sixels.

mod sixel;

use anyhow::{Context, Result, bail};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use clap::{Args, ValueEnum};
use image::{DynamicImage, ImageFormat};
use std::ffi::OsString;
use std::io::{Cursor, IsTerminal, Write};
use terminal_size::{Width, terminal_size};

/// Bytes of base64 that one escape sequence of kitty takes.
const KITTY_CHUNK: usize = 4096;
/// Pixels that a column of a terminal has at least, and columns where nobody knows.
const CELL: u32 = 8;
const COLUMNS: u32 = 80;

/// How a terminal is sent a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Show {
    /// As the terminal says by its environment
    Auto,
    /// The graphics protocol of kitty: kitty, Ghostty, Konsole
    Kitty,
    /// The inline images of iTerm2: iTerm2, WezTerm, mintty, Visual Studio Code
    Iterm,
    /// Sixels: foot, mlterm, xterm -ti vt340, Windows Terminal
    Sixel,
}

/// Whether a picture is shown.
#[derive(Debug, Args)]
pub(crate) struct ShowArgs {
    /// Show the picture in the terminal, where that can show pictures; a protocol that is named is used wherever output goes
    #[arg(long, value_enum, value_name = "PROTOCOL", num_args = 0..=1, require_equals = true, default_missing_value = "auto")]
    show: Option<Show>,
}

impl ShowArgs {
    /// The terminal, if the picture is to be shown.
    pub(crate) fn screen(&self) -> Result<Option<Screen>> {
        self.show.map(Screen::find).transpose()
    }
}

/// A terminal that shows pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Screen {
    protocol: Protocol,
    /// The widest picture that is shown as it is \[pixels\].
    width: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Protocol {
    Kitty,
    Iterm,
    Sixel,
}

impl Screen {
    /// The terminal at standard output; one that is named is believed.
    fn find(show: Show) -> Result<Self> {
        let protocol = match show {
            Show::Kitty => Protocol::Kitty,
            Show::Iterm => Protocol::Iterm,
            Show::Sixel => Protocol::Sixel,
            Show::Auto if !std::io::stdout().is_terminal() => {
                bail!(
                    "--show: standard output is no terminal; --show=kitty, iterm or sixel sends a picture all the same"
                )
            }
            Show::Auto => detect(|name| std::env::var_os(name))?,
        };
        let columns = terminal_size().map_or(COLUMNS, |(Width(columns), _)| columns.max(1).into());
        let width = CELL * columns;
        Ok(Self { protocol, width })
    }

    /// Shows a picture, made smaller where it would not fit.
    pub(crate) fn show(self, png: &[u8]) -> Result<()> {
        let bytes = self.encode(png)?;
        let mut output = std::io::stdout().lock();
        let shown = output.write_all(&bytes).and_then(|()| output.flush());
        shown.context("cannot write to standard output")
    }

    fn encode(self, png: &[u8]) -> Result<Vec<u8>> {
        let whole = image::load_from_memory_with_format(png, ImageFormat::Png).context("the picture cannot be read")?;
        let picture = match whole.width() > self.width {
            true => whole.thumbnail(self.width, u32::MAX),
            false => whole,
        };
        let mut bytes = match self.protocol {
            Protocol::Kitty => kitty(&encoded(&picture)?),
            Protocol::Iterm => iterm(&encoded(&picture)?),
            Protocol::Sixel => {
                let picture = picture.to_rgb8();
                sixel::encode(picture.as_raw(), picture.width() as usize)
            }
        };
        bytes.push(b'\n');
        Ok(bytes)
    }
}

fn encoded(picture: &DynamicImage) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// What a terminal says of itself by variables. Multiplexers pass pictures on to nobody.
fn detect(variable: impl Fn(&str) -> Option<OsString>) -> Result<Protocol> {
    let text = |name: &str| variable(name).unwrap_or_default().to_string_lossy().into_owned();
    let (terminal, program) = (text("TERM"), text("TERM_PROGRAM"));
    if ["tmux", "screen"].iter().any(|name| terminal.starts_with(name)) {
        bail!(
            "--show: tmux and screen keep pictures from the terminal; --show=sixel reaches it through a tmux built with sixels"
        );
    }
    let is_set = |name: &str| !text(name).is_empty();
    let of_iterm = ["iTerm.app", "WezTerm", "mintty", "vscode"];
    if terminal == "xterm-kitty" || program == "ghostty" || is_set("KITTY_WINDOW_ID") || is_set("KONSOLE_VERSION") {
        return Ok(Protocol::Kitty);
    }
    if of_iterm.contains(&program.as_str()) || text("LC_TERMINAL") == "iTerm2" {
        return Ok(Protocol::Iterm);
    }
    let of_sixel = ["foot", "mlterm", "yaft", "contour"]
        .iter()
        .any(|name| terminal.starts_with(name));
    if of_sixel || terminal.contains("sixel") || is_set("WT_SESSION") {
        return Ok(Protocol::Sixel);
    }
    bail!(
        "--show: this terminal (TERM={terminal}) is not known to show pictures; if it does, say how: --show=kitty, iterm or sixel"
    )
}

/// A PNG by the protocol of kitty (<https://sw.kovidgoyal.net/kitty/graphics-protocol>): transmitted and shown, without an answer.
fn kitty(png: &[u8]) -> Vec<u8> {
    let text = STANDARD.encode(png);
    let chunks: Vec<&[u8]> = text.as_bytes().chunks(KITTY_CHUNK).collect();
    let mut bytes = Vec::new();
    for (i, chunk) in chunks.iter().enumerate() {
        let keys = if i == 0 { "a=T,f=100,q=2," } else { "" };
        let more = u8::from(i + 1 < chunks.len());
        bytes.extend_from_slice(format!("\x1b_G{keys}m={more};").as_bytes());
        bytes.extend_from_slice(chunk);
        bytes.extend_from_slice(b"\x1b\\");
    }
    bytes
}

/// A PNG as an inline image of iTerm2 (<https://iterm2.com/documentation-images.html>).
fn iterm(png: &[u8]) -> Vec<u8> {
    let (size, text) = (png.len(), STANDARD.encode(png));
    format!("\x1b]1337;File=inline=1;size={size}:{text}\x07").into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    /// A picture in which every pixel is another one.
    fn picture(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([
                (255 * x / width) as u8,
                (255 * y / height) as u8,
                ((x * 7 + y * 13) % 256) as u8,
            ])
        })
    }

    fn png(picture: &RgbImage) -> Vec<u8> {
        encoded(&DynamicImage::ImageRgb8(picture.clone())).unwrap()
    }

    fn sent(protocol: Protocol, width: u32, picture: &RgbImage) -> Vec<u8> {
        Screen { protocol, width }.encode(&png(picture)).unwrap()
    }

    fn read(base64: &[u8]) -> RgbImage {
        image::load_from_memory(&STANDARD.decode(base64).unwrap())
            .unwrap()
            .to_rgb8()
    }

    #[test]
    fn what_kitty_is_sent_is_the_picture() {
        let picture = picture(120, 70);
        let bytes = sent(Protocol::Kitty, 120, &picture);
        let text = std::str::from_utf8(&bytes).unwrap().strip_suffix("\x1b\\\n").unwrap();
        let chunks: Vec<&str> = text
            .split("\x1b\\")
            .map(|chunk| chunk.strip_prefix("\x1b_G").unwrap())
            .collect();
        let (keys, data): (Vec<&str>, Vec<&str>) = chunks.iter().map(|chunk| chunk.split_once(';').unwrap()).unzip();
        assert!(keys.len() > 2 && data.iter().all(|data| data.len() <= KITTY_CHUNK));
        assert_eq!(keys[0], "a=T,f=100,q=2,m=1");
        assert!(keys[1..keys.len() - 1].iter().all(|keys| *keys == "m=1"));
        assert_eq!(*keys.last().unwrap(), "m=0");
        assert!(read(data.concat().as_bytes()) == picture);
    }

    #[test]
    fn what_iterm_is_sent_is_the_picture() {
        let picture = picture(40, 30);
        let bytes = sent(Protocol::Iterm, 40, &picture);
        let text = std::str::from_utf8(&bytes).unwrap();
        let (head, data) = text.strip_suffix("\x07\n").unwrap().split_once(':').unwrap();
        let size = head.strip_prefix("\x1b]1337;File=inline=1;size=").unwrap();
        assert_eq!(size.parse::<usize>().unwrap(), STANDARD.decode(data).unwrap().len());
        assert!(read(data.as_bytes()) == picture);
    }

    #[test]
    fn wide_pictures_are_made_to_fit() {
        let bytes = sent(Protocol::Iterm, 50, &picture(200, 80));
        let text = std::str::from_utf8(&bytes).unwrap();
        let (_, data) = text.strip_suffix("\x07\n").unwrap().split_once(':').unwrap();
        assert_eq!(read(data.as_bytes()).dimensions(), (50, 20));
    }

    #[test]
    fn terminals_are_known_by_their_variables() {
        let found = |variables: &[(&str, &str)]| {
            let of = |name: &str| variables.iter().find(|(known, _)| *known == name);
            detect(|name| of(name).map(|(_, value)| value.into()))
        };
        for (variables, protocol) in [
            (&[("TERM", "xterm-kitty")][..], Protocol::Kitty),
            (
                &[("TERM", "xterm-256color"), ("TERM_PROGRAM", "ghostty")][..],
                Protocol::Kitty,
            ),
            (
                &[("TERM", "xterm-256color"), ("KONSOLE_VERSION", "230804")][..],
                Protocol::Kitty,
            ),
            (
                &[("TERM", "xterm-256color"), ("TERM_PROGRAM", "iTerm.app")][..],
                Protocol::Iterm,
            ),
            (
                &[("TERM", "xterm-256color"), ("LC_TERMINAL", "iTerm2")][..],
                Protocol::Iterm,
            ),
            (&[("TERM", "foot-extra")][..], Protocol::Sixel),
            (&[("TERM", "xterm-256color"), ("WT_SESSION", "1")][..], Protocol::Sixel),
        ] {
            assert_eq!(found(variables).unwrap(), protocol, "{variables:?}");
        }
        for (terminal, advice) in [
            ("xterm-256color", "--show=kitty, iterm or sixel"),
            ("tmux-256color", "tmux"),
            ("", "TERM="),
        ] {
            let error = found(&[("TERM", terminal)]).unwrap_err().to_string();
            assert!(error.contains(advice), "{error}");
        }
    }
}
