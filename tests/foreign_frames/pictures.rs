//! PNG, TIFF and JPEG pictures of all kinds.

use super::*;
use image::{DynamicImage, GrayAlphaImage, GrayImage, ImageEncoder, Rgb, RgbImage, RgbaImage};
use std::io::Cursor;
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

fn grey() -> GrayImage {
    GrayImage::from_raw(SIZE[0] as u32, SIZE[1] as u32, PIXELS.clone()).unwrap()
}

fn encoded(picture: &DynamicImage, format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

#[test]
fn colour_alpha_and_deep_pictures_are_read_as_luminance() {
    let grey = grey();
    let rgb = RgbImage::from_fn(SIZE[0] as u32, SIZE[1] as u32, |x, y| {
        Rgb([grey[(x, y)].0[0]; 3])
    });
    let rgb = DynamicImage::from(rgb);
    let rgba: RgbaImage = rgb.to_rgba8();
    let grey_alpha: GrayAlphaImage = rgb.to_luma_alpha8();
    for format in [image::ImageFormat::Png, image::ImageFormat::Tiff] {
        for picture in [rgb.clone(), rgba.clone().into(), grey_alpha.clone().into()] {
            if format == image::ImageFormat::Tiff && picture.color() == image::ColorType::La8 {
                continue;
            }
            let frame = read(&encoded(&picture, format), "picture");
            assert_eq!(
                *frame.pixels(),
                Pixels::U8(PIXELS.clone()),
                "{format:?} {:?}",
                picture.color()
            );
            assert_eq!(fields(&frame.info.warnings), ["picture"]);
        }
    }
    let deep = encoded(&rgb.to_rgb16().into(), image::ImageFormat::Png);
    let deep = read(&deep, "picture");
    assert_eq!(deep.bits(), 16);
    assert_solved(&deep, "48 bits of colour");
}

#[test]
fn a_jpeg_gives_the_sun_and_a_warning() {
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95)
        .write_image(
            grey().as_raw(),
            SIZE[0] as u32,
            SIZE[1] as u32,
            image::ExtendedColorType::L8,
        )
        .unwrap();
    let frame = read(&bytes, "picture.jpg");
    assert_solved(&frame, "a JPEG");
    assert_eq!(fields(&frame.info.warnings), ["picture"]);
    assert!(
        frame.info.warnings[0].found.contains("JPG"),
        "{}",
        frame.info.warnings[0]
    );
}

/// A PNG of at most 8 bits per pixel, with or without a palette.
fn png(
    depth: png::BitDepth,
    color: png::ColorType,
    palette: Option<Vec<u8>>,
    data: &[u8],
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, SIZE[0] as u32, SIZE[1] as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if let Some(palette) = palette {
        encoder.set_palette(palette);
    }
    encoder
        .write_header()
        .unwrap()
        .write_image_data(data)
        .unwrap();
    bytes
}

#[test]
fn a_palette_is_applied_and_single_bits_are_dark_or_bright() {
    let greys = (0..=255_u8).flat_map(|dn| [dn; 3]).collect();
    let bytes = png(
        png::BitDepth::Eight,
        png::ColorType::Indexed,
        Some(greys),
        &PIXELS,
    );
    let frame = read(&bytes, "picture.png");
    assert_eq!(*frame.pixels(), Pixels::U8(PIXELS.clone()));
    assert_eq!(fields(&frame.info.warnings), ["picture"]);
    let bits: Vec<u8> = PIXELS
        .chunks_exact(8)
        .map(|dns| {
            dns.iter()
                .fold(0, |byte, dn| byte << 1 | u8::from(*dn > 100))
        })
        .collect();
    let bytes = png(png::BitDepth::One, png::ColorType::Grayscale, None, &bits);
    let frame = read(&bytes, "picture.png");
    let expected = PIXELS.iter().map(|dn| if *dn > 100 { 255 } else { 0 });
    assert_eq!(*frame.pixels(), Pixels::U8(expected.collect()));
    assert_eq!(fields(&frame.info.warnings), ["picture"]);
}

/// A TIFF of greyscale pages, each with an orientation.
fn tiff(pages: &[(&GrayImage, u16)]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    for (page, orientation) in pages {
        let mut image = encoder
            .new_image::<colortype::Gray8>(page.width(), page.height())
            .unwrap();
        image
            .encoder()
            .write_tag(Tag::Orientation, *orientation)
            .unwrap();
        image.write_data(page.as_raw()).unwrap();
    }
    bytes.into_inner()
}

#[test]
fn a_tiff_is_turned_as_its_orientation_says() {
    use image::imageops::{flip_horizontal, flip_vertical, rotate90, rotate180, rotate270};
    let grey = grey();
    // TIFF 6.0, tag 274: position of the file's first row and column in the picture.
    for (orientation, stored) in [
        (1, grey.clone()),
        (2, flip_horizontal(&grey)),
        (3, rotate180(&grey)),
        (4, flip_vertical(&grey)),
        (6, rotate270(&grey)),
        (8, rotate90(&grey)),
    ] {
        let frame = read(&tiff(&[(&stored, orientation)]), "picture.tif");
        assert_eq!(
            *frame.pixels(),
            Pixels::U8(PIXELS.clone()),
            "orientation {orientation}"
        );
    }
}

#[test]
fn a_jpeg_and_a_png_are_turned_as_exif_says() {
    let stored = image::imageops::rotate180(&grey());
    // EXIF with one entry: tag 274, type short, count 1, value 3.
    let exif = [
        &b"MM\0\x2a\0\0\0\x08\0\x01"[..],
        &[1, 0x12, 0, 3, 0, 0, 0, 1, 0, 3, 0, 0, 0, 0, 0, 0],
    ]
    .concat();
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95);
    encoder.set_exif_metadata(exif.clone()).unwrap();
    let (width, height) = stored.dimensions();
    encoder
        .write_image(stored.as_raw(), width, height, image::ExtendedColorType::L8)
        .unwrap();
    assert_solved(&read(&bytes, "picture.jpg"), "a turned JPEG");
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif).unwrap();
    encoder
        .write_image(stored.as_raw(), width, height, image::ExtendedColorType::L8)
        .unwrap();
    let frame = read(&bytes, "picture.png");
    assert_eq!(*frame.pixels(), Pixels::U8(PIXELS.clone()));
}

#[test]
fn of_the_pages_of_a_tiff_the_one_of_the_sensors_size_is_read() {
    let thumbnail = GrayImage::new(162, 121);
    for pages in [[&thumbnail, &grey()], [&grey(), &thumbnail]] {
        let frame = read(&tiff(&pages.map(|page| (page, 1))), "picture.tif");
        assert_eq!(*frame.pixels(), Pixels::U8(PIXELS.clone()));
        let [warning] = frame.info.warnings.as_slice() else {
            panic!("{:?}", frame.info.warnings);
        };
        assert_eq!(warning.expected, "one picture");
    }
}

#[test]
fn a_tiff_of_other_numbers_gives_the_sun() {
    let (width, height) = (SIZE[0] as u32, SIZE[1] as u32);
    type Encoder<'a> = TiffEncoder<&'a mut Cursor<Vec<u8>>>;
    let tiff = |write: &dyn Fn(&mut Encoder)| {
        let mut bytes = Cursor::new(Vec::new());
        write(&mut TiffEncoder::new(&mut bytes).unwrap());
        read(&bytes.into_inner(), "picture.tif")
    };
    let floats: Vec<f32> = PIXELS.iter().map(|dn| f32::from(*dn) / 7.0).collect();
    let frame = tiff(&|encoder| {
        encoder
            .write_image::<colortype::Gray32Float>(width, height, &floats)
            .unwrap()
    });
    assert_solved(&frame, "32 bit floating-point");
    let whole: Vec<i32> = PIXELS.iter().map(|dn| i32::from(*dn) - 7).collect();
    let frame = tiff(&|encoder| {
        encoder
            .write_image::<colortype::GrayI32>(width, height, &whole)
            .unwrap()
    });
    assert_solved(&frame, "32 bit with a sign");
    let frame = tiff(&|encoder| {
        let mut image = encoder
            .new_image::<colortype::Gray8>(width, height)
            .unwrap();
        let greys: Vec<u16> = (0..=255).map(|dn| 257 * dn).collect();
        image
            .encoder()
            .write_tag(Tag::PhotometricInterpretation, 3_u16)
            .unwrap();
        image
            .encoder()
            .write_tag(
                Tag::ColorMap,
                [&greys[..], &greys, &greys].concat().as_slice(),
            )
            .unwrap();
        image.write_data(&PIXELS).unwrap();
    });
    assert_eq!(*frame.pixels(), Pixels::U8(PIXELS.clone()));
    assert_eq!(fields(&frame.info.warnings), ["picture"]);
}
