//! Short labels in an image: numbers and the few letters that units need, in a face of 5 × 7 dots.

use image::RgbImage;

use crate::imaging::draw::Color;

/// Dots of a letter, across and down.
const LETTER: [u32; 2] = [5, 7];
/// From one letter to the next, in dots.
const ADVANCE: u32 = LETTER[0] + 1;

/// Each letter's rows from its top, the leftmost dot the highest of five bits.
const FACE: [(char, [u8; 7]); 32] = [
    ('0', [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110]),
    ('1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('2', [0b01110, 0b10001, 0b00001, 0b00010, 0b00100, 0b01000, 0b11111]),
    ('3', [0b11111, 0b00010, 0b00100, 0b00010, 0b00001, 0b10001, 0b01110]),
    ('4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    ('5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    ('6', [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    ('7', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000]),
    ('8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    ('9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100]),
    ('.', [0, 0, 0, 0, 0, 0b01100, 0b01100]),
    (',', [0, 0, 0, 0, 0b01100, 0b00100, 0b01000]),
    ('-', [0, 0, 0, 0b11111, 0, 0, 0]),
    ('p', [0, 0, 0b11110, 0b10001, 0b11110, 0b10000, 0b10000]),
    ('x', [0, 0, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001]),
    ('s', [0, 0, 0b01110, 0b10000, 0b01110, 0b00001, 0b11110]),
    ('i', [0b00100, 0, 0b01100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('g', [0, 0b01111, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110]),
    ('m', [0, 0, 0b11010, 0b10101, 0b10101, 0b10001, 0b10001]),
    ('a', [0, 0, 0b01110, 0b00001, 0b01111, 0b10001, 0b01111]),
    ('b', [0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b10001, 0b11110]),
    ('e', [0, 0, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110]),
    ('f', [0b00110, 0b01001, 0b01000, 0b11100, 0b01000, 0b01000, 0b01000]),
    ('o', [0, 0, 0b01110, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('r', [0, 0, 0b10110, 0b11001, 0b10000, 0b10000, 0b10000]),
    ('t', [0b01000, 0b01000, 0b11100, 0b01000, 0b01000, 0b01001, 0b00110]),
    ('d', [0b00001, 0b00001, 0b01111, 0b10001, 0b10001, 0b10001, 0b01111]),
    ('h', [0b10000, 0b10000, 0b10110, 0b11001, 0b10001, 0b10001, 0b10001]),
    ('k', [0b10000, 0b10000, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010]),
    ('l', [0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('n', [0, 0, 0b10110, 0b11001, 0b10001, 0b10001, 0b10001]),
    ('w', [0, 0, 0b10001, 0b10001, 0b10101, 0b10101, 0b01010]),
];

/// Whether the face has every letter of `text`, so that none is left blank.
pub fn can_write(text: &str) -> bool {
    text.chars().all(|letter| letter == ' ' || glyph(letter).is_some())
}

/// The width and height of `text` with its border, at `scale` pixels a dot.
pub fn label_size(text: &str, scale: u32) -> [u32; 2] {
    let letters = text.chars().count() as u32;
    [(letters * ADVANCE + 1) * scale, (LETTER[1] + 2) * scale]
}

/// How a label is drawn.
#[derive(Debug, Clone, Copy)]
pub struct LabelStyle {
    /// The color of the letters.
    pub ink: Color,
    /// The color of the plate behind them.
    pub plate: Color,
    /// Pixels a dot.
    pub scale: u32,
}

/// Writes `text` with its top left corner at the pixel `[left, top]`. Letters that the face lacks
/// are left blank, and so is what lies outside the image.
pub fn draw_label(image: &mut RgbImage, text: &str, [left, top]: [u32; 2], style: LabelStyle) {
    let LabelStyle { ink, plate, scale } = style;
    let [width, height] = label_size(text, scale);
    let mut put = |x: u32, y: u32, color: Color| {
        if let Some(pixel) = image.get_pixel_mut_checked(left + x, top + y) {
            *pixel = color;
        }
    };
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        put(x, y, plate);
    }
    for (place, letter) in text.chars().enumerate() {
        let Some(rows) = glyph(letter) else { continue };
        for (x, y) in
            (0..LETTER[1] * scale).flat_map(|y| (0..LETTER[0] * scale).map(move |x| (x, y)))
        {
            if rows[(y / scale) as usize] >> (LETTER[0] - 1 - x / scale) & 1 == 1 {
                put(scale + place as u32 * ADVANCE * scale + x, scale + y, ink);
            }
        }
    }
}

fn glyph(letter: char) -> Option<&'static [u8; 7]> {
    FACE.iter().find(|(known, _)| *known == letter).map(|(_, rows)| rows)
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    #[test]
    fn letters_differ_and_what_is_outside_is_left_out() {
        let (ink, plate) = (Rgb([0, 0, 0]), Rgb([255, 255, 255]));
        let written = |text: &str| {
            let [width, height] = label_size(text, 2);
            let mut image = RgbImage::new(width, height);
            draw_label(&mut image, text, [0, 0], LabelStyle { ink, plate, scale: 2 });
            image
        };
        for (index, (letter, _)) in FACE.iter().enumerate() {
            let this = written(&letter.to_string());
            assert!(this.pixels().any(|pixel| *pixel == ink), "{letter}");
            assert!(
                FACE[..index].iter().all(|(other, _)| written(&other.to_string()) != this),
                "{letter}"
            );
        }
        assert!(written("?").pixels().all(|pixel| *pixel == plate));
        assert!(can_write("-0.05 px") && !can_write("5?"));
        draw_label(
            &mut RgbImage::new(3, 3),
            "0.05 px",
            [1, 2],
            LabelStyle { ink, plate, scale: 2 },
        );
    }
}
