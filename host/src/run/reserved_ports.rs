//! Listening addresses of a bench: first reserved, later opened, after everything else has been checked.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use drivetwin_firmware::device::Port;
use drivetwin_sim::bench::{Bench, Bus, DriveId, Outlet};
use drivetwin_sim::config::layout::{Layout, no_line};
use drivetwin_sim::config::listen::Uri;

use crate::banner::Address;
use crate::ports::{self, Bound, Device, Ports};

/// A line or a port that has a listening address.
#[derive(Clone, Copy)]
enum Reached {
    /// A port of one drive, with its own line if the port is serial: index of the drive in the layout.
    Own(usize, Port),
    /// A line that several drives share: index in the layout.
    Shared(usize),
}

/// A reserved address. No other program can use it.
enum Place {
    Tcp(Bound),
    Rfc2217(Bound),
    Pty(Option<PathBuf>),
    Serial(Device),
    Stdio,
}

/// All reserved addresses of the lines and TCP ports of a layout.
pub(super) struct ReservedPorts(Vec<(Reached, Place)>);

impl ReservedPorts {
    /// Reserves all addresses.
    ///
    /// # Errors
    /// One sentence that names the address, and the reason.
    pub(super) fn all(layout: &Layout) -> Result<Self, String> {
        check_links(layout)?;
        let mut places = Vec::new();
        for (place, drive) in layout.drives.iter().enumerate() {
            for (port, uri) in &drive.listen {
                places.push((Reached::Own(place, *port), reserve(uri)?));
            }
        }
        for (place, bus) in layout.buses.iter().enumerate() {
            for uri in &bus.listen {
                places.push((Reached::Shared(place), reserve(uri)?));
            }
        }
        Ok(Self(places))
    }

    /// Opens all reserved addresses. Returns the addresses of each line and TCP port.
    ///
    /// # Errors
    /// One sentence that names the address, and the reason.
    pub(super) fn open(
        self,
        bench: &mut Bench,
        drives: &[DriveId],
        buses: &[Bus],
    ) -> Result<(Ports, BTreeMap<Outlet, Vec<Address>>), String> {
        let mut ports = Ports::new().map_err(|error| format!("ports cannot be waited for: {error}"))?;
        let mut addresses: BTreeMap<Outlet, Vec<Address>> = BTreeMap::new();
        for (reached, place) in self.0 {
            let outlet = match reached {
                Reached::Own(drive, port) => bench.outlet(drives[drive], port),
                Reached::Shared(bus) => Outlet::Line(buses[bus]),
            };
            let line = || match outlet {
                Outlet::Line(bus) => Ok(bus),
                Outlet::Tcp(..) => Err(no_line(&bench.outlet_name(outlet))),
            };
            let address = match place {
                Place::Tcp(bound) => Address::Uri(
                    ports.add_tcp(outlet, bound).map_err(|error| format!("tcp: cannot listen: {error}"))?,
                ),
                Place::Rfc2217(bound) => {
                    let added = ports.add_rfc2217(line()?, bound);
                    Address::Uri(added.map_err(|error| format!("rfc2217: cannot listen: {error}"))?)
                }
                Place::Pty(link) => {
                    let bus = line()?;
                    Address::Pty {
                        path: ports.add_pty(bench, bus, link.clone()).map_err(|error| error.to_string())?,
                        link,
                    }
                }
                Place::Serial(device) => {
                    let bus = line()?;
                    Address::Uri(ports.add_serial(bench, bus, device))
                }
                Place::Stdio => {
                    let bus = line()?;
                    let added = ports.add_stdio(bench, bus);
                    added.map_err(|error| format!("stdio: cannot be read and written: {error}"))?;
                    Address::Uri(Uri::Stdio.to_string())
                }
            };
            addresses.entry(outlet).or_default().push(address);
        }
        Ok((ports, addresses))
    }
}

/// Checks that no two ptys have the same link, even if the paths are written differently.
fn check_links(layout: &Layout) -> Result<(), String> {
    let own = layout.drives.iter().flat_map(|drive| &drive.listen).map(|(_, uri)| uri);
    let shared = layout.buses.iter().flat_map(|bus| &bus.listen);
    let mut places: BTreeMap<PathBuf, &Uri> = BTreeMap::new();
    for uri in own.chain(shared) {
        let Uri::Pty(Some(link)) = uri else { continue };
        let folder = Path::new(".").join(link).parent().map(Path::canonicalize);
        // If the folder does not exist, the check of the link reports that.
        if let (Some(Ok(folder)), Some(name)) = (folder, link.file_name())
            && let Some(other) = places.insert(folder.join(name), uri)
        {
            return Err(format!("{other} and {uri} are the same path; use two different ones"));
        }
    }
    Ok(())
}

fn reserve(uri: &Uri) -> Result<Place, String> {
    match uri {
        Uri::Tcp(address) => Ok(Place::Tcp(reserve_tcp("tcp:", address)?)),
        Uri::Rfc2217(address) => Ok(Place::Rfc2217(reserve_tcp("rfc2217:", address)?)),
        Uri::Pty(link) => {
            if let Some(link) = link {
                ports::check_link(link).map_err(|error| format!("{uri}: {error}"))?;
            }
            Ok(Place::Pty(link.clone()))
        }
        Uri::Serial(path) => match Device::open(path) {
            Ok(device) => Ok(Place::Serial(device)),
            Err(error) => Err(format!("{uri} cannot be opened: {error}")),
        },
        Uri::Stdio => Ok(Place::Stdio),
    }
}

/// Reserves `HOST:PORT`; `what` begins the error message.
///
/// # Errors
/// One sentence that says what is wrong: the address cannot be reserved.
pub(super) fn reserve_tcp(what: &str, address: &str) -> Result<Bound, String> {
    ports::bind(address).map_err(|error| match error.kind() {
        io::ErrorKind::AddrInUse => {
            format!("{what}{address} is in use; use another port, or port 0 for any free one")
        }
        _ => format!("cannot listen at {what}{address}: {error}"),
    })
}
