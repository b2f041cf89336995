//! A master by ethercrab: ethercrab_master INTERFACE scan ENTRIES | move MOTION LOG | clocks.
//!
//! Run in a network namespace of its own by test_ethercat_masters.py, which lists what the files hold.
//! Prints one line of JSON.

use std::time::{Duration, Instant};
use std::{env, fs};

use ethercrab::error::Error;
use ethercrab::std::{ethercat_now, tx_rx_task};
use ethercrab::subdevice_group::DcConfiguration;
use ethercrab::{
    DcSync, MainDevice, MainDeviceConfig, ObjectDescriptionListQuery, PduStorage, RegisterAddress,
    Timeouts,
};

const DRIVES: usize = 8; // a power of 2, at least as many as there are
const BYTES: usize = 14; // process data of a drive, each way
const PDI: usize = 256;
const HOLD: usize = 20_000; // exchanges that are timed
const KP: f64 = 0.3; // 0.1 % of the rated torque per count: of the loop around CST
const KD: f64 = 0.006; // per count/s

static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

/// What a drive reports.
#[derive(Clone, Copy, Default)]
struct Reported {
    status: u16,
    q: i32,
    v: i32,
}

fn reported(inputs: &[u8]) -> Reported {
    Reported {
        status: u16::from_le_bytes(inputs[0..2].try_into().unwrap()),
        q: i32::from_le_bytes(inputs[2..6].try_into().unwrap()),
        v: i32::from_le_bytes(inputs[6..10].try_into().unwrap()),
    }
}

fn outputs(control: u16, q: i32, v: i32, torque: i16, mode: u8) -> [u8; BYTES] {
    let mut out = [0; BYTES];
    out[0..2].copy_from_slice(&control.to_le_bytes());
    out[2..6].copy_from_slice(&q.to_le_bytes());
    out[6..10].copy_from_slice(&v.to_le_bytes());
    out[10..12].copy_from_slice(&torque.to_le_bytes());
    out[12] = mode;
    out
}

/// The controlword that brings a drive on its way to Operation enabled.
fn enabling(status: u16) -> u16 {
    match (status & 0x6f, status & 0x4f) {
        (_, 0x08) => 0x80,
        (_, 0x40) => 0x06,
        (0x21, _) => 0x07,
        (0x23, _) | (0x27, _) => 0x0f,
        _ => 0x06,
    }
}

fn main() -> Result<(), Error> {
    let words: Vec<String> = env::args().collect();
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let master = MainDevice::new(
        pdu_loop,
        Timeouts {
            pdu: Duration::from_millis(500),
            state_transition: Duration::from_secs(10),
            mailbox_echo: Duration::from_secs(2),
            mailbox_response: Duration::from_secs(2),
            wait_loop_delay: Duration::from_micros(200),
            ..Timeouts::default()
        },
        MainDeviceConfig {
            dc_static_sync_iterations: 1000,
            ..MainDeviceConfig::default()
        },
    );
    let line = tx_rx_task(&words[1], tx, rx).expect("interface");
    std::thread::spawn(|| async_io::block_on(line));
    async_io::block_on(async {
        match words[2].as_str() {
            "scan" => scan(&master, &words[3]).await,
            "clocks" => clocks(&master).await,
            _ => follow(&master, &words[3], &words[4]).await,
        }
    })
}

/// Reads every entry that a file names (index, sub, bytes; 0: a text), and the list of objects.
async fn scan(master: &MainDevice<'_>, entries: &str) -> Result<(), Error> {
    let group = master.init_single_group::<DRIVES, PDI>(ethercat_now).await?;
    let first = group.subdevice(master, 0)?;
    let mut values = Vec::new();
    for one in fs::read_to_string(entries).expect("entries").lines() {
        let words: Vec<u32> = one.split(' ').map(|word| word.parse().unwrap()).collect();
        let (index, sub) = (words[0] as u16, words[1] as u8);
        let value: Vec<u8> = match words[2] {
            0 => first.sdo_read::<heapless::String<128>>(index, sub).await?.into_bytes().to_vec(),
            1 => vec![first.sdo_read::<u8>(index, sub).await?],
            2 => first.sdo_read::<u16>(index, sub).await?.to_le_bytes().to_vec(),
            4 => first.sdo_read::<u32>(index, sub).await?.to_le_bytes().to_vec(),
            _ => first.sdo_read::<u64>(index, sub).await?.to_le_bytes().to_vec(),
        };
        let hex: String = value.iter().map(|byte| format!("{byte:02x}")).collect();
        values.push(format!("\"{index}:{sub}\": \"{hex}\""));
    }
    let list = first.sdo_info_object_description_list(ObjectDescriptionListQuery::All).await?;
    let indices: Vec<String> = list.unwrap_or_default().iter().map(|one| one.to_string()).collect();
    let mut names = Vec::new();
    for one in group.iter(master) {
        names.push(format!("[\"{}\", {}]", one.name(), one.identity().product_id));
    }
    println!(
        "{{\"slaves\": [{}], \"objects\": [{}], \"values\": {{{}}}}}",
        names.join(", "),
        indices.join(", "),
        values.join(", ")
    );
    Ok(())
}

/// Aligns the clocks, switches SYNC0 on at 1 kHz, and exchanges process data in step with it.
async fn clocks(master: &MainDevice<'_>) -> Result<(), Error> {
    let mut group = master.init_single_group::<DRIVES, PDI>(ethercat_now).await?;
    let period = Duration::from_millis(1);
    for mut one in group.iter_mut(master) {
        one.set_dc_sync(DcSync::Sync0);
    }
    let group = group.into_pre_op_pdi(master).await?;
    for _ in 0..200 {
        group.tx_rx_sync_system_time(master).await?;
    }
    let (mut differences, mut delays) = (Vec::new(), Vec::new());
    for one in group.iter(master) {
        let sign_and_size: u32 = one.register_read(RegisterAddress::DcSystemTimeDifference).await?;
        differences.push((sign_and_size & 0x7fff_ffff).to_string());
        delays.push(one.propagation_delay().to_string());
    }
    let settings = DcConfiguration {
        start_delay: Duration::from_millis(10),
        sync0_period: period,
        sync0_shift: period / 2,
    };
    let group = group.configure_dc_sync(master, settings).await?;
    let group = group.into_safe_op(master).await?.request_into_op(master).await?;
    let (mut in_op, mut waits) = (false, Vec::new());
    for _ in 0..500 {
        let began = Instant::now();
        let answer = group.tx_rx_dc(master).await?;
        in_op = in_op || answer.all_op();
        waits.push(answer.extra.next_cycle_wait.as_nanos().to_string());
        async_io::Timer::at(began + answer.extra.next_cycle_wait).await;
    }
    println!(
        "{{\"differences\": [{}], \"delays\": [{}], \"in_op\": {in_op}, \"waits\": [{}]}}",
        differences.join(", "),
        delays.join(", "),
        waits.join(", ")
    );
    Ok(())
}

/// Enables all drives; follows the motion, a third each in CSP, CSV and CST; stops.
async fn follow(master: &MainDevice<'_>, motion: &str, log: &str) -> Result<(), Error> {
    let group = master.init_single_group::<DRIVES, PDI>(ethercat_now).await?;
    let drives = group.len();
    let raw = fs::read(motion).expect("motion");
    let rows: Vec<&[u8]> = raw.chunks_exact(10 * drives).collect();
    let group = group.into_safe_op(master).await?.request_into_op(master).await?;

    let mut kept: Vec<u8> = Vec::new();
    let mut now = vec![Reported::default(); drives];
    let mut to_send = vec![[0u8; BYTES]; drives];
    let (mut row, mut bad, mut exchanges, mut in_op) = (0, 0, 0, false);
    let mut started = Instant::now();
    while row < rows.len() {
        let enabled = in_op && now.iter().all(|one| one.status & 0x6f == 0x27);
        if !enabled {
            started = Instant::now();
            assert!(exchanges < 20_000, "drives are not enabled");
        }
        let mode = 8 + (3 * row / rows.len()).min(2) as u8;
        for (k, one) in now.iter().enumerate() {
            if !in_op {
                continue;
            }
            let at = &rows[row][10 * k..10 * k + 10];
            let (mut q, mut v, mut torque) = (one.q, 0, 0);
            if enabled {
                q = i32::from_le_bytes(at[0..4].try_into().unwrap());
                v = i32::from_le_bytes(at[4..8].try_into().unwrap());
                let ahead = i16::from_le_bytes(at[8..10].try_into().unwrap()) as f64;
                let loop_ = KP * (q - one.q) as f64 + KD * (v - one.v) as f64;
                torque = (ahead + loop_).round().clamp(-1000.0, 1000.0) as i16;
                if mode == 9 {
                    v += 10 * (q - one.q);
                }
            }
            to_send[k] = outputs(enabling(one.status), q, v, torque, mode);
        }
        for (one, bytes) in group.iter(master).zip(&to_send) {
            one.outputs_raw_mut().copy_from_slice(bytes);
        }
        let answer = group.tx_rx(master).await;
        let good = matches!(&answer, Ok(one) if one.working_counter == 3 * drives as u16);
        bad += !good as usize;
        exchanges += 1;
        kept.push(good as u8);
        to_send.iter().for_each(|one| kept.extend(one));
        for (k, one) in group.iter(master).enumerate() {
            let inputs = one.inputs_raw();
            kept.extend(inputs.iter());
            now[k] = reported(&inputs);
        }
        in_op = in_op || matches!(&answer, Ok(one) if one.all_op());
        row += enabled as usize;
    }
    let moved = started.elapsed();
    let hold = Instant::now();
    let mut bad_in_hold = 0;
    for (k, one) in group.iter(master).enumerate() {
        one.outputs_raw_mut().copy_from_slice(&outputs(0x0f, now[k].q, 0, 0, 8));
    }
    for _ in 0..HOLD {
        let answer = group.tx_rx(master).await;
        bad_in_hold += !matches!(answer, Ok(one) if one.working_counter == 3 * drives as u16) as usize;
    }
    let held = hold.elapsed();
    fs::write(log, kept).expect("log");
    println!(
        "{{\"exchanges\": {exchanges}, \"before_motion\": {}, \"bad\": {bad}, \"moved_per_s\": {}, \
         \"exchanges_per_s\": {}, \"bad_of_20000\": {bad_in_hold}}}",
        exchanges - rows.len(),
        rows.len() as f64 / moved.as_secs_f64(),
        HOLD as f64 / held.as_secs_f64()
    );
    group.into_safe_op(master).await?.into_pre_op(master).await?.into_init(master).await?;
    Ok(())
}
